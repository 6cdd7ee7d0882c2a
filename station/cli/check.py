"""``station check``: measure an episode from its file, and judge it."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from station.cli.options import data_option, json_option


@click.command("check")
@click.argument("episode")
@data_option
@click.option("--no-write", is_flag=True, help="Leave the manifest as it is.")
@json_option
def command(episode: str, data: Path | None, no_write: bool, as_json: bool) -> None:
    """Check EPISODE (a path, an id, the beginning of one, or `latest`); exit code 1 when it is to be rejected."""
    from station.cli.report import print_quality
    from station.episode.check import check, write_measured
    from station.episode.reader import open_episode

    reader = open_episode(episode, data)
    quality = check(reader)
    if quality.is_finished and not no_write:
        write_measured(reader.folder, quality)
    if as_json:
        click.echo(msgspec.json.encode(quality))
    else:
        print_quality(quality)
    raise SystemExit(1 if quality.verdict == "reject" else 0)
