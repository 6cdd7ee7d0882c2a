"""``station episodes compact``: JPEG pictures become video, after each was compared."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from station.cli import candidates
from station.cli.options import data_option, jobs_option, json_option, task_option
from station.cli.tidy import wanted_rows
from station.errors import StationError, UsageError
from station.printable import printable

if TYPE_CHECKING:
    from station.episode.compacting.compact import CompactResult, Progress
    from station.export.jobs import Attempt

_LONGEST = 4000  # characters of a line


@click.command("compact")
@click.argument("episodes", metavar="[EPISODE]...", nargs=-1, shell_complete=candidates.episodes)
@click.option("--all", "is_all", is_flag=True, help="Every finished episode.")
@click.option("--older-than", "older", metavar="WHEN", default=None,
              help="Those that started more than 12h or 30d ago, or before 2026-11-20.")  # fmt: skip
@task_option
@click.option("--crf", type=click.IntRange(1, 40), default=24, show_default=True, metavar="N",
              help="Quality of x264: lower is better, larger; 20 keeps noise: 2 dB, five times the size.")  # fmt: skip
@click.option("--gop", type=click.IntRange(1, 600), default=30, show_default=True, metavar="N",
              help="A key picture at least every N pictures: fewer are smaller, and slower to jump to.")  # fmt: skip
@jobs_option
@click.option("--dry-run", is_flag=True, help="Show what would be done, and do nothing.")
@click.option("--yes", is_flag=True, help="Do it without asking.")
@data_option
@json_option
def command(
    episodes: Sequence[str], is_all: bool, older: str | None, task: Sequence[str], crf: int, gop: int, jobs: int,
    dry_run: bool, yes: bool, data: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Make the JPEG pictures of episodes H.264, for good: some fifteen times smaller, and read by all that read them.

    Every time stamp stays as it is, and so does depth, byte for byte. Every picture is compared with its JPEG file
    before that goes: an episode with a camera of less than 35 dB of PSNR stays as it is, and a line says so. Ended at
    any moment, an episode has the ones or the other; the same command goes on with what is left. It asks first. Exit
    code 1 when an episode is damaged, changed or being written, or the disk refused.
    """
    from station.episode.compacting.compact import compact
    from station.episode.storage import layout
    from station.episode.storage.folder import data_folder
    from station.episode.storage.named_lock import remove_unlocked
    from station.episode.storage.whole_file import part_of
    from station.export.jobs import DiskRefuses, map_episodes
    from station.video import library

    base = data_folder(data)
    if not (episodes or is_all or older is not None or task):
        raise UsageError("name EPISODEs, or say which: --all, --older-than 30d, --task NAME; --dry-run shows which")
    library()  # before anything is asked
    folders = [Path(row.path) for row in wanted_rows(base, episodes, (), older, task, is_discarded=None)]
    files = [file for folder in folders if (file := folder / layout.CAMERAS).is_file()]
    if files and not (dry_run or yes):
        _ask(files)
    with _bar(folders) as progress:
        tell = progress if len(folders) == 1 else None
        do = partial(compact, data=base, crf=crf, gop=gop, dry_run=dry_run, progress=tell)
        done: list[Attempt[Path, CompactResult]] = []

        def on_done(attempt: Attempt[Path, CompactResult]) -> None:
            done.append(attempt)
            _say(attempt, is_dry=dry_run, is_quiet=as_json)
            if tell is None:
                progress(len(done), len(folders))

        try:
            map_episodes(do, folders, jobs=1 if dry_run else jobs, on_done=on_done)
        except DiskRefuses as error:
            raise StationError(
                f"{error.item}: {error}; make room, run it again: it goes on with what is left"
            ) from error
        finally:  # of processes that were ended in the middle
            for file in files:
                remove_unlocked(part_of(file))
    found = [attempt.result for attempt in done if attempt.result is not None]
    if as_json:
        click.echo(msgspec.json.encode(found))
    elif not folders:
        click.echo(f"no episode in {base.absolute()} fits: nothing to compact")
    elif len(folders) > 1:
        _sum_up(found, is_dry=dry_run)
    raise SystemExit(1 if len(found) < len(done) else 0)


def _ask(files: Sequence[Path]) -> None:
    count, size = len(files), sum(file.stat().st_size for file in files) / 1e6
    what = f"the pictures of {count} episode{'' if count == 1 else 's'}, {size:.1f} MB,"
    if not sys.stdin.isatty():
        raise UsageError(f"compact: there is no terminal to ask in; --yes makes {what} H.264 for good")
    if not click.confirm(f"Make {what} H.264, and delete the JPEG files for good?", err=True):
        raise SystemExit(1)


@contextmanager
def _bar(folders: Sequence[Path]) -> Iterator[Progress]:
    """Show how far it is, on a terminal and while it lasts: messages of one episode, or episodes."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        name = printable(folders[0].name) if len(folders) == 1 else "episodes"
        task = shown.add_task(name, total=None if len(folders) == 1 else len(folders))
        yield lambda done, of: shown.update(task, completed=done, total=of)


def _say(attempt: Attempt[Path, CompactResult], *, is_dry: bool, is_quiet: bool) -> None:
    """Say in a line what became of an episode."""
    found = attempt.result
    if found is None:
        click.echo(f"station: {printable(attempt.error, _LONGEST)}", err=True)
    elif not is_quiet:
        words = {
            "no-pictures": "no pictures in colour in it" if found.kept else "no pictures in it",
            "current": f"compacted already{f', {_sizes(found)}' if found.pictures else ''}",
            "left": f"left as it is: {found.why}",
            "compacted": f"{found.bytes_before / 1e6:.1f} MB of pictures" if is_dry else
            f"{_sizes(found)} in {found.seconds:.1f} s",
        }  # fmt: skip
        kept = f"; depth stays as it is: {', '.join(found.kept)}" if found.kept else ""
        click.echo(printable(f"{found.episode_id} {words[found.state]}{kept}", _LONGEST))


def _sizes(found: CompactResult) -> str:
    sizes = f"{found.bytes_before / 1e6:.1f} MB to {found.bytes_after / 1e6:.1f} MB"
    ratio = found.bytes_before / max(1, found.bytes_after)
    return (
        f"{sizes} ({ratio:.1f} times smaller), {found.pictures} pictures, PSNR {found.psnr_db or 0.0:.1f} dB, "
        f"worst {found.psnr_worst_db or 0.0:.1f}"
    )


def _sum_up(found: Sequence[CompactResult], *, is_dry: bool) -> None:
    states = {state: [one for one in found if one.state == state] for state in ("compacted", "left", "current")}
    done = states["compacted"]
    before, after = (sum(one.bytes_before for one in done) / 1e6, sum(one.bytes_after for one in done) / 1e6)
    what = f"{len(done)} episode{'' if len(done) == 1 else 's'}"
    words = f"{what}, {before:.1f} MB, would be compacted" if is_dry else (
        f"{what} compacted, {before:.1f} MB to {after:.1f} MB"
    )  # fmt: skip
    rest = {"left": "left as they are", "current": "compacted before"}
    told = [f"{len(states[state])} {name}" for state, name in rest.items() if states[state]]
    click.echo("; ".join([words, *told]))
