"""``station enrich``: typed siblings of what was recorded, for viewers that know nothing of us."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from station.cli import candidates
from station.cli.options import data_option, json_option
from station.errors import EpisodeError, UsageError
from station.printable import printable

_LONGEST = 4000  # characters of an error

if TYPE_CHECKING:
    from station.enrich.enrich import Enriched, Progress


@click.command("enrich")
@click.argument("episodes", metavar="[EPISODE]...", nargs=-1, shell_complete=candidates.episodes)
@click.option("--all", "is_all", is_flag=True, help="Every finished episode that was not discarded.")
@click.option("--force", "is_forced", is_flag=True, help="Make files anew though nothing has changed.")
@click.option("--no-pictures", is_flag=True, help="Leave pictures where they are: a fraction of the size.")
@data_option
@json_option
def command(
    episodes: Sequence[str], is_all: bool, is_forced: bool, no_pictures: bool, data: Path | None, as_json: bool
) -> None:
    """Write enriched.mcap beside the signals of each EPISODE, for Rerun, Foxglove and any reader of MCAP.

    Every key whose elements have names gets a topic KEY/typed, protobuf with one named field per element and its unit;
    pictures, poses and events get Foxglove's own message types. The recording itself stays as it is. What is up to
    date is left alone. A viewer that opens cameras.mcap beside it needs no copy of the pictures: --no-pictures. Exit
    code 1 when an episode could not be enriched.
    """
    if bool(episodes) == is_all:
        raise UsageError("name the EPISODEs to enrich, or give --all")
    done: list[Enriched] = []
    failed = False
    for name in _finished(data) if is_all else episodes:
        try:
            done.append(_enriched(name, data, is_forced=is_forced, pictures=not no_pictures, is_quiet=as_json))
        except EpisodeError as error:
            failed = True
            click.echo(f"station: {printable(str(error), _LONGEST)}", err=True)
    if as_json:
        click.echo(msgspec.json.encode(done))
    elif done:
        _print_left_out(done)
    elif not failed:
        click.echo("no finished episode: nothing to enrich")
    raise SystemExit(1 if failed else 0)


def _finished(data: Path | None) -> list[str]:
    from station.episode.reading.listing import list_episodes

    rows = [row for row in list_episodes(data) if not row.is_discarded]
    for row in rows:
        if row.state != "finished":
            click.echo(f"station: {row.episode_id}: left out, it is {row.state}", err=True)
    return [row.path for row in rows if row.state == "finished"]


def _enriched(
    name: str, data: Path | None, *, is_forced: bool, pictures: bool, is_quiet: bool
) -> Enriched:  # fmt: skip
    """Enrich one episode and say in a line what became of it."""
    from station.enrich.enrich import enrich
    from station.episode.reading.reader import open_episode

    reader = open_episode(name, data)
    with _bar(reader.episode_id) as progress:
        found = enrich(reader, is_forced=is_forced, pictures=pictures, progress=progress)
    if not is_quiet:
        size, unfit = f"{found.size_bytes / 1e6:.1f} MB", sum(found.unfit.values())
        words = f"{found.topics} typed topics, {found.messages} messages, {size} in {found.seconds:.1f} s"
        more = f"; {unfit} values did not fit their contract ({', '.join(sorted(found.unfit))})" if unfit else ""
        what = "up to date" if found.state == "current" else words + printable(more)
        click.echo(f"{printable(found.episode_id)} {what}: {found.path}")
    return found


@contextmanager
def _bar(episode_id: str) -> Iterator[Progress]:
    """Show how far an episode is, on a terminal and while it lasts."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(printable(episode_id), total=None)
        yield lambda done, of: shown.update(task, completed=done, total=of)


def _print_left_out(done: Sequence[Enriched]) -> None:
    """Print once what has no typed topic in any of the episodes, and why."""
    keys_of: dict[str, set[str]] = {}
    for found in done:
        for key, reason in found.left_out.items():
            keys_of.setdefault(reason, set()).add(key)
    for reason, keys in keys_of.items():
        click.echo(f"not typed, {reason}: {printable(', '.join(sorted(keys)))}")
