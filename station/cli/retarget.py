"""``station retarget``: motion capture files of people as motion files of a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import click
import msgspec

from station import registry
from station.cli import candidates
from station.cli.options import NamedPath, jobs_option, json_option
from station.errors import BadFile, Interrupted, UnknownName, UsageError
from station.printable import printable
from station.retargeting import Retargeted, RetargetTask, Unit, retarget

_TOLD = 20  # files that came to nothing and are told; the rest are counted
_JOINTS = 3  # of a file that are named, those longest at a limit


@click.command("retarget")
@click.argument("files", nargs=-1, required=True, shell_complete=candidates.files)
@click.option("--to", "robot", required=True, shell_complete=candidates.registered("retargeter"),
              help="Name of the robot.")  # fmt: skip
@click.option("--out", "-o", metavar="DIR", required=True, type=NamedPath(file_okay=False, path_type=Path),
              help="Folder of the motion files; made where it is missing.")  # fmt: skip
@click.option("--height", "height_m", metavar="M", type=click.FloatRange(1.2, 2.2), default=None,
              help="How tall the person is [m]; every file is scaled so.  [default: what the file says]")  # fmt: skip
@click.option("--units", type=click.Choice(get_args(Unit)), default=None,
              help="Of the files' lengths.  [default: what the file says, else a guess by how tall the person is]",
              )  # fmt: skip
@click.option("--fps", type=click.FloatRange(10, 200), default=50.0, show_default=True,
              help="Frames per second of the motions.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace motion files that are there.")
@jobs_option
@json_option
def command(
    files: Sequence[str], robot: str, out: Path, height_m: float | None, units: Unit | None, fps: float, force: bool,
    jobs: int, as_json: bool,
) -> None:  # fmt: skip
    """Make motions of a robot of FILES: motion capture of people, as BVH, AMASS (.npz) or C3D; of a folder, all that it
    holds.

    \b
    station retarget walk.bvh --to unitree_g1 --out motions       motions/walk.npz
    station retarget amass/CMU --to unitree_g1 --out motions      folders inside stay folders
    station rehearse 'motions/*.npz'                              does the robot fall?

    A motion that is there already, made of the same file in the same way, is kept: a run that was interrupted goes on.
    Exit code 1 when a file could not be made a motion; all others are.
    """
    for name, value in (("fps", fps), ("height", height_m)):
        if value is not None and math.isnan(value):  # which is in every range
            raise UsageError(f"--{name}: expected a number, got nan")
    if robot not in (known := registry.names("retargeter")):
        raise UnknownName("robot to retarget to", robot, known)
    tasks = [
        RetargetTask(source=source, target=target, robot=robot, fps=fps, units=units, height_m=height_m, force=force)
        for source, target in _paths(files, out)
    ]
    made, failed = _all(tasks, jobs, is_quiet=as_json)
    if as_json:
        lost = [{"source": str(task.source), "reason": why} for task, why in failed]
        click.echo(msgspec.json.encode({"motions": made, "failed": lost}))
    else:
        _print(made)
        for line in [f"failed: {printable(why)}" for _, why in failed][:_TOLD]:
            click.echo(line, err=True)
        if len(failed) > _TOLD:
            click.echo(f"failed: {len(failed) - _TOLD} more", err=True)
    raise SystemExit(1 if failed or any(each.why_not for each in made) else 0)


def _paths(files: Sequence[str], out: Path) -> list[tuple[Path, Path]]:
    """Return each capture with the motion file to make of it.

    Raises:
        BadFile: a file that is not there, or a folder without captures.
        UsageError: two would have the same motion file, or a motion file would take the place of a capture.
    """
    pairs: list[tuple[Path, Path]] = []
    suffixes = tuple(f".{name}" for name in registry.names("capture"))
    for file in files:
        path = Path(file)
        if path.is_dir():
            inside = sorted(each for each in path.rglob("*") if each.suffix.lower() in suffixes and each.is_file())
            if not inside:
                raise BadFile(f"{file}: holds no captures; expected files that end in {', '.join(suffixes)}")
            pairs += [(each, out / each.relative_to(path).with_suffix(".npz")) for each in inside]
        elif path.is_file():
            pairs.append((path, out / f"{path.stem}.npz"))
        else:
            raise BadFile(f"{file}: no such file; name captures, or a folder of them")
    sources = {source.resolve() for source, _ in pairs}
    taken: dict[Path, Path] = {}
    for source, target in pairs:
        if target.resolve() in sources:
            raise UsageError(f"--out: {target} is itself a capture that is named; choose another folder")
        if (other := taken.setdefault(target, source)) != source:
            raise UsageError(f"{other} and {source} would both be {target}; retarget them into different folders")
    return list({target: (source, target) for source, target in pairs}.values())


def _all(
    tasks: Sequence[RetargetTask], jobs: int, *, is_quiet: bool
) -> tuple[list[Retargeted], list[tuple[RetargetTask, str]]]:
    """Retarget all; return what came of them, and which failed, with why."""
    from station.export.jobs import Attempt, map_episodes
    from station.export.progress import progress

    done = 0
    try:
        with progress(len(tasks), "retarget", is_quiet=is_quiet) as tell:

            def on_done(attempt: Attempt[RetargetTask, Retargeted]) -> None:
                nonlocal done
                is_lost = attempt.result is None or bool(attempt.result.why_not)
                done += not is_lost
                tell(is_lost=is_lost)

            attempts = map_episodes(retarget, tasks, jobs=jobs, on_done=on_done)
    except KeyboardInterrupt:
        raise Interrupted(
            f"interrupted; {done} of {len(tasks)} motions are made and kept; the same command goes on from there"
        ) from None
    made = [attempt.result for attempt in attempts if attempt.result is not None]
    return made, [(attempt.item, attempt.error) for attempt in attempts if attempt.result is None]


def _print(made: Sequence[Retargeted]) -> None:
    from station.cli.tables import Column, plain, print_table

    fresh = [each for each in made if not each.is_kept]
    columns = [
        Column("capture", "left"), *map(Column, ("length", "rate", "person")), Column("at a limit", "left"),
        Column("slowed", "left"), Column("feet slide"), Column("played", "left"),
    ]  # fmt: skip
    rows = [
        (plain(each.source), f"{each.seconds:.1f} s", f"{each.captured_fps:.4g} to {each.fps:g} Hz",
         f"{each.height_m:.2f} m", plain(_longest(each.at_limit_s)), plain(_longest(each.slowed_s)),
         f"{100 * each.slide_mps:.1f} cm/s", "[red]no[/]" if each.why_not else "[green]yes[/]")
        for each in fresh
    ]  # fmt: skip
    if rows:
        print_table(columns, rows)
    said: dict[str, list[str]] = {}
    for each in fresh:
        for note in each.notes:
            said.setdefault(note, []).append(each.source)
    for note, sources in said.items():
        of = sources[0] if len(sources) == 1 else f"{len(sources)} captures"
        click.echo(printable(f"{of}: {note}"))
    for each in fresh:
        if each.why_not:
            click.echo(printable(f"not played: {each.why_not}"))
    if kept := len(made) - len(fresh):
        click.echo(f"{kept} there already, made of the same files in the same way")
    written = [each.target for each in fresh if each.target]
    if written:
        click.echo(f"{len(written)} written; does the robot fall? station rehearse {printable(written[0])}")


def _longest(times_s: dict[str, float]) -> str:
    """Return what took longest, as in ``left_elbow 0.4 s, 2 more``."""
    ordered = sorted(times_s.items(), key=lambda item: -item[1])
    more = [f"{len(ordered) - _JOINTS} more"] if len(ordered) > _JOINTS else []
    return ", ".join([f"{name} {time_s:.1f} s" for name, time_s in ordered[:_JOINTS]] + more)
