"""The audit of an episode in short, of all its robots, for a verdict.

Every `station check` asks for it, of episodes that are not longer than `LONGEST_S`, and where what it needs is on this
machine: nothing is fetched. An episode that is still recorded is not audited unasked. Between takes a robot may run
while somebody checks the last one: the audit then takes a core for a second or so more than the check itself.
"""

from __future__ import annotations

from collections.abc import Iterator

from station.bus import keys
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader
from station.episode.replaying.arm_audit import ArmAudit, audit_arm, is_arm
from station.episode.replaying.audit import Audit, audit
from station.episode.replaying.comparison import Comparison
from station.episode.storage.manifest_parts import AuditDifference, AuditFound
from station.errors import StationError

LONGEST_S = 60.0
"""Episodes that are longer are not audited unasked [s]: an audit takes twice as long as the rest of a check."""


def audit_in_short(reader: EpisodeReader, *, longest_s: float | None = None) -> AuditFound:
    """Audit every robot of an episode; one that cannot be is said in a line, and is no difference.

    Args:
        reader: The episode.
        longest_s: An episode that is longer is not audited, and a line says so [s].
    """
    found = AuditFound()
    if why_not := _why_not(reader, longest_s):
        found.not_audited.append(f"{why_not}; `station check --audit` audits it all the same")
        return found
    for robot in steps.robots(reader.topics()):
        try:
            _add(reader, robot, found)
        except StationError as error:
            found.not_audited.append(f"{robot}: {error}")
    return found


def _why_not(reader: EpisodeReader, longest_s: float | None) -> str:
    """Return why an episode is not audited unasked, or ""."""
    if longest_s is None:
        return ""
    if reader.is_active:
        return "a recorder is still at it, perhaps beside a robot"
    last_ns = max((stream.last_ns for stream in reader.streams()), default=reader.start_ns)
    length_s = (last_ns - reader.start_ns) * 1e-9
    return f"{length_s:.0f} s, longer than {longest_s:g} s" if length_s > longest_s else ""


def _other_runtime(found: Audit) -> str:
    """Return in words that the network runs on something else here, which gives other last bits; or ""."""
    pairs = ((each.recorded_runtime, each.runtime) for each in (found, *found.took_over))
    words = (
        f"recorded on {recorded}, here is {here}: last bits differ"
        for recorded, here in pairs
        if recorded and recorded != here
    )
    return next(words, "")


def _add(reader: EpisodeReader, robot: str, found: AuditFound) -> None:
    if is_arm(reader, robot):
        arm = audit_arm(reader, robot)
        found.not_proven += arm.incomplete
        told = list(_of_arm(arm))
    else:
        policy = audit(reader, robot=robot)
        told = list(_of_gate(policy, robot))
        if (why := _other_runtime(policy)) and policy.different + policy.observations.different:
            found.not_audited.append(f"{robot}: actions and observations: {why}")
        else:
            told += _of_policy(policy, robot)
        told.append(_compared(keys.target(robot), [keys.policy_action(robot)], policy.targets))
        reasons = (policy.commands_not_proven, policy.targets_not_proven)
        found.not_proven += policy.incomplete + policy.past_unknown + sum(sum(why.values()) for why in reasons)
    found.compared += sum(one.compared for one in told)
    found.different += sum(one.different for one in told)
    found.differences += [one for one in told if one.different]


def _of_arm(arm: ArmAudit) -> Iterator[AuditDifference]:
    used = keys.command_used(arm.robot)
    yield _compared(used, [arm.command_key], arm.commands)
    yield _state(arm.robot, arm.command_key, arm.states_different, arm.first_state_different_s)
    yield _compared(keys.target(arm.robot), [used, keys.state_joints(arm.robot)], arm.targets)


def _of_gate(policy: Audit, robot: str) -> Iterator[AuditDifference]:
    yield _compared(keys.command_used(robot), policy.command_key.split(", "), policy.commands)
    yield _state(robot, policy.command_key, policy.gates_different, policy.first_gate_different_s)


def _of_policy(policy: Audit, robot: str) -> Iterator[AuditDifference]:
    seen, done = keys.policy_obs(robot), keys.policy_action(robot)
    yield _compared(seen, [keys.robot_state(robot), keys.command_used(robot)], policy.observations)
    actions = Comparison(compared=policy.steps, different=policy.different, first_different_s=policy.first_different_s)
    yield _compared(done, [seen], actions)


def _compared(key: str, of: list[str], found: Comparison) -> AuditDifference:
    return AuditDifference(
        key=key, of=of, compared=found.compared, different=found.different, first_s=found.first_different_s
    )


def _state(robot: str, command: str, different: int, first_s: float | None) -> AuditDifference:
    """Return how often a gate was in another state; what it let through was counted already."""
    return AuditDifference(key=keys.command_gate(robot), of=[command], compared=0, different=different, first_s=first_s)
