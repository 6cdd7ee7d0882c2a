"""``station episodes``: what has been recorded."""

from __future__ import annotations

import json
from pathlib import Path

import click
import msgspec

from station.cli import check
from station.cli.options import Verbs, data_option, json_option


@click.group("episodes", cls=Verbs)
def command() -> None:
    """List, show and check recorded episodes."""


command.add_command(check.command, "check")


@command.command("list")
@click.option("--task", default=None, help="Episodes of this task alone.")
@data_option
@json_option
def listing(task: str | None, data: Path | None, as_json: bool) -> None:
    """List the episodes of a data folder, oldest first."""
    from station.episode.folder import data_folder
    from station.episode.listing import list_episodes

    rows = list_episodes(data, task=task)
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(rows)))
        return
    if not rows:
        click.echo(f"no episodes in {data_folder(data).absolute()}; record one, or name another folder with --data")
        return
    from station.cli.tables import Column, print_table

    columns = [
        Column("episode", "left"), Column("state", "left"), Column("verdict", "left"), Column("length"),
        Column("messages"), Column("lost"), Column("falls"), Column("success"), Column("size"),
        Column("operator", "left"),
    ]  # fmt: skip
    cells = [
        (
            row.episode_id,
            "discarded" if row.is_discarded else row.state,
            row.problem or row.verdict or "unchecked",
            "" if row.seconds is None else f"{row.seconds:.1f} s",
            str(row.messages),
            str(row.lost),
            str(row.falls),
            {None: "–", True: "yes", False: "no"}[row.success],
            f"{row.size_bytes / 1e6:.1f} MB",
            row.operator,
        )
        for row in rows
    ]
    print_table(columns, cells)


@command.command("show")
@click.argument("episode")
@data_option
@json_option
def show(episode: str, data: Path | None, as_json: bool) -> None:
    """Show what EPISODE says of itself, and count its streams from the file."""
    from station.episode.manifest import dump_manifest
    from station.episode.reader import open_episode
    from station.episode.show import show as facts_of

    facts = facts_of(open_episode(episode, data))
    if as_json:
        click.echo(msgspec.json.encode(facts, enc_hook=str))
        return
    click.echo(f"# {facts.path}: {facts.messages} messages, {facts.size_bytes / 1e6:.1f} MB in {facts.file}")
    if facts.torn:
        click.echo(f"# torn: {facts.torn}")
    facts.manifest.streams = facts.streams
    click.echo(dump_manifest(facts.manifest).decode().rstrip())
