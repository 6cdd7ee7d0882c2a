"""``station audit``: the policy again, on what was recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from station.cli.options import data_option, episode_argument, json_option
from station.errors import StationError, UsageError

if TYPE_CHECKING:
    from station.episode.replaying.arm_audit import ArmAudit
    from station.episode.replaying.audit import Audit
    from station.episode.replaying.comparison import Comparison


@click.command("audit")
@episode_argument
@data_option
@click.option("--checkpoint", default=None, help="Where the checkpoint is, when it is not where it was.")
@click.option("--robot", default=None, help="Suffix of the robot, when the episode has several.")
@json_option
def command(episode: str, data: Path | None, checkpoint: str | None, robot: str | None, as_json: bool) -> None:
    """Run the policy again on the recorded observations of EPISODE, and derive those again from state and command.

    Of an arm, which has no policy, the recorded commands go through its gate again, and targets are compared. Exit code
    1 when any bit of any action, observation or target differs, or when there was none to compare. Of several robots
    each is audited, and --json prints a list; one that cannot be is an object with its ``error``.
    """
    from station.episode.reading import steps
    from station.episode.reading.reader import open_episode
    from station.episode.replaying.arm_audit import audit_arm, is_arm
    from station.episode.replaying.audit import audit

    reader = open_episode(episode, data)
    robots: list[str | None] = [robot] if robot is not None else [*steps.robots(reader.topics())] or [None]
    if checkpoint is not None and sum(each is None or not is_arm(reader, each) for each in robots) > 1:
        raise UsageError("audit --checkpoint: name the robot whose it is with --robot; the episode has several")
    found: list[Audit | ArmAudit | dict[str, str]] = []
    is_equal = True
    for each in robots:
        try:
            if each is not None and is_arm(reader, each):
                arm = audit_arm(reader, each)
                found.append(arm)
                told, is_equal = arm_story(arm), is_equal and arm.is_equal
            else:
                policy = audit(reader, checkpoint=checkpoint, robot=each)
                found.append(policy)
                told, is_equal = story(policy), is_equal and policy.is_equal
        except StationError as error:
            if each is None or len(robots) == 1:
                raise
            found.append({"robot": each, "error": str(error)})  # the others are audited all the same
            told, is_equal = f"{reader.episode_id} ({each}): NOT AUDITED: {error}", False
        if not as_json:
            click.echo(told)
    if as_json:
        click.echo(msgspec.json.encode(found if len(found) > 1 else found[0]))
    raise SystemExit(0 if is_equal else 1)


def story(found: Audit) -> str:
    """Return what an audit found, in words."""
    return "\n".join(
        (
            f"{found.episode_id} ({found.robot}): {found.policy} {found.checkpoint} sha256 {found.sha256[:12]}…",
            *(
                f"  took over     {each.policy} {each.checkpoint} sha256 {each.sha256[:12]}…"
                for each in found.took_over
            ),
            f"  actions       {found.steps} steps, {found.different} different, max |Δ| {found.max_abs_difference:.3g}",
            f"  observations  {_observations(found)}",
            f"  after gate    {_proven(found.commands, found.commands_not_proven)}"
            + (f"; its state differs in {found.gates_different}" if found.gates_different else ""),
            *(
                f"    {name:<11} {_compared(one, 'steps', '', 'nothing to compare')}"
                for name, one in found.parts.items()
            ),
            f"  targets       {_proven(found.targets, found.targets_not_proven)}",
            f"  recorded on   {found.recorded_runtime or 'unknown'}\n  audited on    {found.runtime}",
            f"  {found.segments} segment{'s' * (found.segments != 1)}, {found.incomplete} incomplete steps; "
            f"{found.speed_x_realtime:.0f} x real time",
        )
    )


def _observations(found: Audit) -> str:
    """Return what became of the observations, in words."""
    if found.has_observations:
        return _compared(found.observations, "steps", "", found.not_derived)
    unknown = f"; {found.past_unknown} steps not proven: what the policy had seen before is not in the file"
    return f"not recorded; derived, and equal where the actions are{unknown * bool(found.past_unknown)}"


def in_short(found: Audit) -> str:
    """Return in a line that an audit found nothing different; the whole story otherwise."""
    if not found.is_equal:
        return story(found)
    policies = " and ".join(each.policy for each in (found, *found.took_over))
    return f"{policies}, run again on what was recorded: {found.steps} steps, {found.different} different"


def arm_story(found: ArmAudit) -> str:
    """Return what an audit of an arm found, in words."""
    why = f"{found.followed} ticks followed a command, {found.incomplete} of them incomplete"
    commands, targets = (_compared(one, "ticks", " rad", why) for one in (found.commands, found.targets))
    return "\n".join(
        (
            f"{found.episode_id} ({found.robot}): commands through the gate again",
            f"  after gate    {commands}; its state differs in {found.states_different}",
            f"  targets       {targets}; {found.refused} ticks refused by the controller's session",
            f"  {found.steps} ticks, {found.followed} of them followed a command, in {found.segments} segments; "
            f"{found.incomplete} incomplete",
        )
    )


def _proven(found: Comparison, not_proven: dict[str, int]) -> str:
    """Return what was compared, and what was not, and why."""
    why = "; ".join(f"{count} steps not proven: {reason}" for reason, count in not_proven.items())
    told = _compared(found, "steps", "", why or "nothing to compare")
    return f"{told}; {why}" if found.compared and why else told


def _compared(found: Comparison, what: str, unit: str, why_not: str) -> str:
    if not found.compared:
        return f"NOT AUDITED: {why_not}"
    return f"{found.compared} {what}, {found.different} different, max |Δ| {found.max_abs_difference:.3g}{unit}"
