"""``station episodes``: what has been recorded."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click
import msgspec

from station.cli import candidates, check, compact, enrich, tidy
from station.cli.options import NamedPath, Verbs, data_option, episode_argument, json_option
from station.printable import printable

_LONGEST = 10_000  # characters of a line of a manifest

if TYPE_CHECKING:
    from station.episode.reading.listing import EpisodeRow
    from station.episode.writing.repair import Cut, Repaired


@click.group("episodes", cls=Verbs)
def command() -> None:
    """List, show, check, enrich, repair, tag, tidy up and compact recorded episodes."""


command.add_command(check.command, "check")
command.add_command(enrich.command, "enrich")
for verb in (*tidy.COMMANDS, compact.command):
    command.add_command(verb)


@command.command("list")
@click.option("--task", default=None, shell_complete=candidates.tasks, help="Episodes of this task alone.")
@click.option("--operator", default=None, help="Episodes of this operator alone.")
@click.option("--min-quality", "least", type=click.Choice(("good", "usable")), default=None,
              help="Checked to be this or better, and not discarded.")  # fmt: skip
@click.option("--verdict", "verdicts", type=click.Choice(("good", "usable", "reject", "unchecked")), multiple=True,
              help="Of this verdict; may repeat.")  # fmt: skip
@click.option("--success", type=click.Choice(("yes", "no", "unknown")), default=None, help="What the operator said.")
@click.option("--tag", "tags", multiple=True, metavar="TAG", help="With this tag; may repeat: with all of them.")
@click.option("--since", "since_", metavar="WHEN", default=None, help="Started within 2h or 3d, or since 2026-11-20.")
@click.option("--bin", "is_bin", is_flag=True, help="List what `station episodes prune` moved into the bin.")
@data_option
@json_option
def listing(
    task: str | None, operator: str | None, least: Literal["good", "usable"] | None, verdicts: tuple[str, ...],
    success: Literal["yes", "no", "unknown"] | None, tags: tuple[str, ...], since_: str | None, is_bin: bool,
    data: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """List the episodes of a data folder, oldest first; every option leaves out what does not fit it."""
    from station.episode.reading.listing import EpisodeFilter, list_episodes, since
    from station.episode.storage.bin import bin_folder
    from station.episode.storage.folder import data_folder
    from station.episode.storage.left_open import offer

    if is_bin:
        data = bin_folder(data_folder(data))
    wanted = EpisodeFilter(
        task=task, operator=operator, verdicts=verdicts, least=least, success=success, tags=tags,
        since=None if since_ is None else since(since_),
    )  # fmt: skip
    if (line := offer(data_folder(data))) is not None:
        click.echo(f"station: {line}", err=True)
    rows = list_episodes(data, wanted=wanted)
    if least is not None:
        any_verdict = msgspec.structs.replace(wanted, least=None, verdicts=("unchecked",))
        if unchecked := [row for row in list_episodes(data, wanted=any_verdict) if not row.is_discarded]:
            click.echo(
                f"station: {len(unchecked)} left out that were never checked; `station check` them, "
                "--verdict unchecked lists them", err=True,
            )  # fmt: skip
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(rows)))
        return
    if not rows:
        where = data_folder(data).absolute()
        is_all = wanted == EpisodeFilter()
        if is_bin and is_all:
            click.echo(f"nothing in {where}")
            return
        click.echo(
            f"no episodes in {where}; record one, or name another folder with --data"
            if is_all else f"no episode in {where} fits; leave out an option, or name another folder with --data"
        )  # fmt: skip
        return
    _print_rows(rows)
    for row in rows:
        if row.problem:
            click.echo(f"{printable(row.episode_id)}: {printable(row.problem)}")
        if row.changed:
            click.echo(f"{printable(row.episode_id)}: changed after it was closed or checked: {printable(row.changed)}")


def _print_rows(rows: Sequence[EpisodeRow]) -> None:
    from station.cli.tables import Column, plain, print_table

    columns = [
        Column("episode", "left"), Column("state", "left"), Column("verdict", "left"), Column("length"),
        Column("messages"), Column("lost"), Column("falls"), Column("success"), Column("size"),
        Column("operator", "left"), *([Column("tags", "left")] if (has_tags := any(row.tags for row in rows)) else []),
    ]  # fmt: skip
    cells = [
        (
            plain(row.episode_id),
            "discarded" if row.is_discarded else row.state,
            plain("–" if row.state == "broken" else row.verdict or "unchecked"),
            "" if row.seconds is None else f"{row.seconds:.1f} s",
            str(row.messages),
            f"{row.lost}, {row.dropped} dropped" if row.dropped else str(row.lost),
            str(row.falls),
            {None: "–", True: "yes", False: "no"}[row.success],
            f"{row.size_bytes / 1e6:.1f} MB",
            plain(row.operator),
            *([plain(", ".join(row.tags))] if has_tags else []),
        )
        for row in rows
    ]
    print_table(columns, cells)


@command.command("show")
@episode_argument
@data_option
@json_option
def show(episode: str, data: Path | None, as_json: bool) -> None:
    """Show what EPISODE says of itself, and count its streams from its files."""
    from station.episode.reading.reader import open_episode
    from station.episode.reading.show import show as facts_of
    from station.episode.storage.manifest import dump_manifest, words_of_shortened

    facts = facts_of(open_episode(episode, data))
    if as_json:
        click.echo(msgspec.json.encode(facts, enc_hook=str))
        return
    files = ", ".join(f"{size / 1e6:.1f} MB in {name}" for name, size in facts.files.items())
    click.echo(f"# {facts.path}: {facts.messages} messages, {files}")
    if facts.torn:
        click.echo(f"# torn: {facts.torn}")
    if facts.manifest.shortened:
        click.echo(f"# {words_of_shortened(facts.manifest.shortened)}")
    facts.manifest.streams = facts.streams
    lines = dump_manifest(facts.manifest).decode().rstrip().split("\n")
    click.echo("\n".join(printable(line, _LONGEST) for line in lines))


@command.command("repair")
@click.argument("episode", required=False, shell_complete=candidates.episodes)
@click.option("--all", "is_all", is_flag=True, help="Every episode that was left open, or whose file is cut off.")
@click.option(
    "--out", metavar="DIR", default=None, type=NamedPath(file_okay=False, path_type=Path),
    help="Put good episodes there and leave the torn ones alone.  [default: beside the torn file]",
)  # fmt: skip
@data_option
@json_option
def repair(episode: str | None, is_all: bool, out: Path | None, data: Path | None, as_json: bool) -> None:
    """Make a good episode of a torn or damaged one: EPISODE, or `--all` that were left open or are cut off.

    Every whole chunk is kept; what was lost between two of them is said, and is a hole in the manifest, for which
    `station check` rejects the episode. A torn file stays as it is, beside the good one, as signals.mcap.torn or
    cameras.mcap.torn.
    """
    from station.episode.storage.folder import data_folder, resolve
    from station.episode.storage.left_open import to_repair
    from station.episode.writing.repair import remove_what_never_began
    from station.errors import EpisodeError, UsageError

    if (episode is None) != is_all:
        raise UsageError("name one EPISODE to repair, or give --all")
    done: list[Repaired] = []
    failed = False
    if episode is not None:
        folders = [_folder(resolve(episode, data))]
    else:
        remove_what_never_began(data_folder(data))
        folders, changing = to_repair(data_folder(data))
        for folder in changing:
            failed = True
            told = (
                "changed less than 10 s ago and lacks its end: perhaps it is still being copied; left alone, try again"
            )
            click.echo(f"station: {folder.name}: its file {told}", err=True)
    for folder in folders:
        try:
            done.append(_repaired(folder, out, is_quiet=as_json))
        except EpisodeError as error:
            failed = True
            click.echo(f"station: {error}", err=True)
    if as_json:
        click.echo(msgspec.json.encode(done))
    elif not folders and not failed:
        click.echo(f"no episode in {data_folder(data).absolute()} is left open or cut off: nothing to repair")
    raise SystemExit(1 if failed else 0)


def _folder(episode: Path) -> Path:
    return episode.parent if episode.is_file() else episode


def _repaired(folder: Path, out: Path | None, *, is_quiet: bool) -> Repaired:
    """Repair one episode and say what became of it."""
    from station.episode.writing.repair import repair

    done = repair(folder, out=out)
    words = {
        "whole": "is whole: nothing to repair",
        "closed": f"was whole but not closed: closed, {done.messages} messages",
        "repaired": f"repaired: kept {done.messages} messages ({done.seconds or 0.0:.1f} s)"
        + f"; {done.cut_messages} that were in the file before it was damaged are gone" * bool(done.cut_messages),
    }
    if not is_quiet:
        click.echo(f"{done.episode_id} {words[done.state]}")
        for cut in done.cuts:
            click.echo(f"  {cut.file}: {_lost(cut)}; the torn file is {cut.original}")
    return done


def _lost(cut: Cut) -> str:
    """Return in words what was cut of a file."""
    if cut.from_s is None:
        return f"cut {cut.bytes} bytes after byte {cut.at}"
    until = "the end" if cut.to_s is None else f"{cut.to_s:.2f} s ({cut.to_s - cut.from_s:.2f} s)"
    return f"{cut.bytes} damaged bytes left out after byte {cut.at}: nothing of it from {cut.from_s:.2f} s to {until}"
