"""``station rehearse``: motions through policy and simulation, offline; with ``--suite``, a policy's evaluation."""

from __future__ import annotations

import itertools
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, get_args

import click
import msgspec

from station import registry
from station.cli import candidates
from station.cli.options import json_option
from station.cli.tables import Column, print_table
from station.config import build, merged, overrides
from station.contract import names_of
from station.errors import UnknownName, UsageError
from station.suite.cases import Group

if TYPE_CHECKING:
    from station.control.rig import RigConfig
    from station.protocols import Floats
    from station.rehearse import Rehearsal
    from station.suite.outcome import Outcome
    from station.suite.run import Evaluation
    from station.suite.survived import PolicyCommands

_TOLD = 8  # cases of a group that failed and are told


@click.command("rehearse")
@click.argument("motions", nargs=-1, shell_complete=candidates.files)
@click.option("--suite", is_flag=True, help="Run the evaluation of a policy, with all clips there are or with MOTIONS.")
@click.option("--robot", default="", shell_complete=candidates.registered("robot"),
              help="Name of the robot.  [default: the station's]")  # fmt: skip
@click.option("--policy", default="", shell_complete=candidates.registered("policy"),
              help="Name of the policy family.  [default: the robot's]")  # fmt: skip
@click.option("--checkpoint", default="", help="File of the policy.  [default: the family's]")
@click.option("--robot-model", default=None, help="Model of a simulated robot.  [default: its own]")
@click.option(
    "--physics-dt", "physics_dt_s", type=float, default=None, help="Physics time step [s].  [default: the robot's]"
)
@click.option("--set", "sets", multiple=True, metavar="KEY=VALUE",
              help="A setting of the robot's server: policy_options.NAME, robot_options.NAME; may repeat.")  # fmt: skip
@click.option("--holes", type=click.Choice(["refuse", "bridge"]), default="refuse", show_default=True,
              help="What is done with bad frames inside a motion; not with --suite.")  # fmt: skip
@click.option("--envelope", "envelope_file", type=click.Path(dir_okay=False, path_type=Path), default=None,
              metavar="FILE", help="Write what the policy survives of MOTIONS: its envelope.")  # fmt: skip
@click.option("--episode", "episodes", multiple=True, metavar="EPISODE", shell_complete=candidates.episodes,
              help="--envelope: a recorded episode of the policy, which counts as well; may repeat.")  # fmt: skip
@click.option("--jobs", default=0, help="Processes side by side.  [default: one per core]")
@click.option("--quick", is_flag=True, help="--suite: fewer instants, and one minute in place of ten.")
@click.option(
    "--only", "only", multiple=True, type=click.Choice(get_args(Group)), help="--suite: these groups; may repeat."
)
@click.option("--against", default="", metavar="POLICY", help="--suite: another policy, run beside it and compared.")
@click.option("--against-checkpoint", default="", help="File of that policy.  [default: the family's]")
@click.option("--hand-over", default="", metavar="POLICY", shell_complete=candidates.registered("policy"),
              help="--suite: what takes turns with a policy of velocities.  [default: itself]")  # fmt: skip
@click.option("--hand-over-checkpoint", default="", help="File of that policy.  [default: the family's]")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), default=None, metavar="FILE",
              help="--suite: draw velocities and paths to a PNG.")  # fmt: skip
@click.option("--markdown", "as_markdown", is_flag=True, help="--suite: print the table for a model card.")
@json_option
def command(
    motions: Sequence[str], robot: str, policy: str, checkpoint: str, robot_model: str | None,
    physics_dt_s: float | None, sets: tuple[str, ...], holes: str, jobs: int, as_json: bool, suite: bool,
    envelope_file: Path | None, episodes: tuple[str, ...], against: str, against_checkpoint: str, **of_suite: Any,
) -> None:  # fmt: skip
    """Run MOTIONS (files, or patterns such as 'twist2:motions/*.pkl' or 'builtin:*') in a closed loop and print how
    each went. Exit code 1 when the robot fell in any of them.

    With --suite: standing, every clip, pushes, random arm motion, delayed commands, lost and restored commands; of a
    policy that follows velocities each axis both ways, curves, and hand-overs in place of clips and arms. Exit code 1
    when the policy did not keep a limit; station/suite/promise.py has them all.
    """
    from station.assets import inventory
    from station.control.rig import RigConfig, robot_kind
    from station.view.offscreen import VARIABLE

    os.environ[VARIABLE] = "disable"  # nothing is drawn: no process need look for OpenGL as it imports MuJoCo
    if envelope_file is not None and (suite or as_json):
        raise UsageError("--envelope goes with MOTIONS, and without --suite and --json")
    if envelope_file is not None and not envelope_file.absolute().parent.is_dir():
        raise UsageError(f"--envelope {envelope_file}: no folder {envelope_file.parent}")
    if episodes and envelope_file is None:
        raise UsageError("--episode goes with --envelope")
    _refuse_what_does_not_go_together([*motions, *episodes], suite, {"against": against, **of_suite})
    kind = robot_kind(robot)
    policy = policy or kind.policy
    for name in filter(None, (policy, against, of_suite["hand_over"])):
        if name not in (known := registry.names("policy")):
            raise UnknownName("policy", name, known)  # before any motion is read
    named = [reference for motion in motions for reference in inventory.motions_named(motion)]
    told: dict[str, Any] = {"robot": kind.name, "policy": policy, "checkpoint": checkpoint}
    if twice := [name for name in told if any(each.startswith(f"{name}=") for each in sets)]:
        raise UsageError(f"--set {twice[0]}=…: name it with --{twice[0]}")
    named_options = {"model": robot_model, "physics_dt_s": physics_dt_s}
    told["robot_options"] = {name: value for name, value in named_options.items() if value is not None}
    asked = overrides(sets, servers=None).get("", {})
    config = build(RigConfig, merged(told, asked), where="--set")
    kind.typed(config.robot_options)  # before any motion is read
    if envelope_file is not None:
        _envelope(config, named, episodes, envelope_file, holes=holes, jobs=jobs)
    if not suite:
        _motions(config, named, holes=holes, jobs=jobs, as_json=as_json)
    other = msgspec.structs.replace(config, policy=against, checkpoint=against_checkpoint, policy_options={})
    _suite([config, other] if against else [config], named, jobs=jobs, as_json=as_json, **of_suite)


def _refuse_what_does_not_go_together(motions: Sequence[str], suite: bool, of_suite: dict[str, Any]) -> None:
    given = [name.removeprefix("as_").replace("_", "-") for name, value in of_suite.items() if value]
    if not suite and given:
        raise UsageError(f"--{given[0]} goes with --suite")
    if not suite and not motions:
        raise UsageError("name a motion to rehearse, for example builtin:wave; or evaluate a policy with --suite")


def _envelope(
    config: RigConfig, named: Sequence[str], episodes: Sequence[str], file: Path, *, holes: str, jobs: int
) -> NoReturn:
    """Write the envelope of episodes, and of the motions that are survived; exit code 1 when one was not."""
    from station.suite import survived

    of = survived.commands_of(config)
    recorded = {name: each for reference in episodes for name, each in [_recorded(reference, of)]}
    tell = _teller(len(named))
    played = survived.play(named, config, holes=holes, jobs=jobs, on_done=lambda each: tell(each.rehearsal))
    taken = [each for each in played if survived.is_survived(each)]
    streams = [each.commands for each in taken] + [stream for each in recorded.values() for stream in each]
    envelope = survived.measured(streams, of.command, of.period_s)
    if played:
        _print([each.rehearsal for each in played])
    left_out = [each.rehearsal.motion for each in played if not survived.is_survived(each)]
    if left_out:
        click.echo(f"left out, not survived or not followed: {', '.join(left_out)}")
    survived.write(envelope, file, [each.rehearsal.motion for each in taken] + [f"episode {name}" for name in recorded])
    counted = [(len(taken), "motion"), *([(len(recorded), "episode")] if recorded else [])]
    streams_of = " and ".join(f"{count} {what}{'s' * (count != 1)}" for count, what in counted)
    click.echo(f"saved {file}: {len(envelope.elements)} elements of the command, from {streams_of}")
    raise SystemExit(1 if left_out else 0)


def _recorded(reference: str, of: PolicyCommands) -> tuple[str, list[Floats]]:
    """Return the id of an episode, and the commands that its policy got, shape (steps, m) each, without holes.

    Raises:
        EpisodeError: there is none, or it is damaged.
        UsageError: another policy drove, it had other commands, the robot fell, or it has none.
    """
    import numpy as np

    from station.api.episode import open_episode

    opened = open_episode(reference)
    drove = opened.manifest.policy
    if drove.sha256 != of.sha256:
        raise UsageError(
            f"--episode {reference}: policy {drove.name!r} of sha256 {drove.sha256[:12] or '(none)'} drove; expected "
            f"the one that is measured, {of.sha256[:12]}: what another survives says nothing of it"
        )
    if falls := opened.check().falls:
        raise UsageError(f"--episode {reference}: the robot fell ({falls}); what was asked of it was not survived")
    steps = opened.steps(of.command.robot)
    if steps.command.names != (expected := names_of(of.command.elements)):
        raise UsageError(
            f"--episode {reference}: commands of {len(steps.command.names)} elements were recorded; expected the "
            f"{len(expected)} of {of.command.name!r}"
        )
    values = steps.command.values
    is_whole = np.asarray(np.isfinite(values).all(axis=1))
    follows_on = (np.diff(steps.number) == 1) & is_whole[1:] & is_whole[:-1]
    pieces = np.split(values, np.flatnonzero(~follows_on) + 1)
    found = [piece for piece in pieces if len(piece) > 1]
    if not found:
        raise UsageError(f"--episode {reference}: no commands that a policy got were recorded")
    return opened.id, found


def _motions(config: RigConfig, named: Sequence[str], *, holes: str, jobs: int, as_json: bool) -> NoReturn:
    from station.rehearse import rehearse_all

    results = rehearse_all(named, config, holes=holes, jobs=jobs, on_done=_teller(len(named)))
    if as_json:
        click.echo(json.dumps({"motions": msgspec.to_builtins(results)}))
    else:
        _print(results)
    raise SystemExit(1 if any(result.fell for result in results) else 0)


def _teller(count: int) -> Callable[[Rehearsal], None]:
    """Return what says on stderr how many of some motions are done."""
    done = itertools.count(1)
    return lambda result: click.echo(f"{next(done)}/{count} {result.motion}", err=True)


def _suite(
    rigs: Sequence[RigConfig], named: Sequence[str], *, quick: bool, only: Sequence[Group], jobs: int, as_json: bool,
    as_markdown: bool, hand_over: str, hand_over_checkpoint: str, plot: Path | None,
) -> NoReturn:  # fmt: skip
    from station.suite import promise, run, table

    planned = run.plan(
        rigs, extent=promise.QUICK if quick else promise.FULL, named=named, only=only, jobs=jobs,
        hand_over=(hand_over, hand_over_checkpoint),
    )  # fmt: skip
    if plot is not None and not planned.walks:
        raise UsageError("--plot draws velocities that were followed; no case of this suite has any")
    if planned.missing:
        click.echo(f"left out, not on this machine: {', '.join(planned.missing)}", err=True)
    click.echo(f"{planned.runs} runs in {planned.processes} processes", err=True)
    with _Progress(planned.runs) as progress:
        done = run.run(planned, progress.on_result)
    if plot is not None:
        from station.view.velocity_plot import Walk, save_walks

        walks = [
            Walk(f"{policy.label}: {case.case}", case.trace.times_s, case.trace.commanded, case.trace.measured,
                 case.trace.path)
            for policy in done.policies for case in policy.cases if case.trace is not None
        ]  # fmt: skip
        click.echo(f"saved {save_walks(walks, plot)}", err=True)
    if as_json:
        click.echo(msgspec.json.encode(done))
    elif as_markdown:
        click.echo(table.markdown(done.policies, table.CASE_TITLES if done.is_of_velocities else table.TITLES))
    else:
        _print_suite(done)
    raise SystemExit(0 if done.is_kept else 1)


class _Progress:
    """Says on stderr how far a suite is, and what fell: a bar in a terminal, else a line now and then."""

    def __init__(self, runs: int) -> None:
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(console=Console(stderr=True, highlight=False, soft_wrap=True), transient=True)
        self._task = self._bar.add_task("", total=runs)
        self._runs, self._done, self._began_s = runs, 0, time.monotonic()

    def __enter__(self) -> _Progress:
        if self._bar.console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def on_result(self, policy: str, outcome: Outcome) -> None:
        self._done += 1
        self._bar.advance(self._task)
        if outcome.falls:
            self._bar.console.print(f"{policy}: {outcome.group}: {outcome.case}: {outcome.falls[0]}", markup=False)
        has_more = self._done * 20 // self._runs > (self._done - 1) * 20 // self._runs
        if has_more and not self._bar.console.is_terminal:
            left_s = (time.monotonic() - self._began_s) / self._done * (self._runs - self._done)
            click.echo(f"{self._done}/{self._runs}, about {left_s / 60:.1f} min left", err=True)


def _print_suite(done: Evaluation) -> None:
    from rich.markup import escape

    from station.suite import table

    titles = table.CASE_TITLES if done.is_of_velocities else table.TITLES
    columns = [Column(escape(title), "left" if title in table.LEFT else "right") for title in titles]
    colours = {"kept": "green", "failed": "red"}
    verdict = titles.index("verdict")
    rows = []
    for row in table.case_rows(done.policies) if done.is_of_velocities else table.rows(done.policies):
        cells = [escape(cell) for cell in row]
        colour = colours.get(row[verdict].split()[-1])
        cells[verdict] = f"[{colour}]{cells[verdict]}[/]" if colour else cells[verdict]
        rows.append(cells)
    print_table(columns, rows)
    for summary in done.policies[0].groups:
        for failure in summary.failures[:_TOLD]:
            click.echo(f"{summary.group}: {failure.case}: {failure.reason}")
        if len(summary.failures) > _TOLD:
            click.echo(f"{summary.group}: … and {len(summary.failures) - _TOLD} more; --json has them all")
    summaries = [summary for policy in done.policies for summary in policy.groups]
    simulated_s = sum(summary.simulated_s for summary in summaries)
    runs = sum(summary.runs for summary in summaries)
    seeds = "" if done.is_of_velocities else f"; seeds of the arms {' '.join(map(str, done.extent.arm_seeds))}"
    click.echo(
        f"{runs} runs, {simulated_s:.0f} s simulated in {done.wall_s:.0f} s by {done.processes} processes{seeds}"
    )


def _print(results: Sequence[Rehearsal]) -> None:
    columns = [Column("motion", "left"), *map(Column, ("fell", "joint error", "height error", "simulated", "speed"))]
    rows = [
        (
            result.motion,
            f"[red]at {result.fell_at_s:.1f} s[/]" if result.fell_at_s is not None else "[green]no[/]",
            _number(result.mean_joint_error_rad, "rad"),
            _number(result.mean_root_height_error_m, "m"),
            f"{result.seconds:.1f} s",
            f"{result.speed_x_realtime:.1f} x",
        )
        for result in results
    ]
    print_table(columns, rows)
    for result in results:
        for line in result.velocity.lines() if result.velocity is not None else ():
            click.echo(f"{result.motion}: {line}")


def _number(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}"
