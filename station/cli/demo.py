"""``station demo``: the main job once, and its report."""

from __future__ import annotations

from pathlib import Path

import click

from station import assets
from station.cli.options import data_option
from station.errors import StationError


@click.command("demo")
@data_option
@click.option(
    "--for", "for_", metavar="DURATION", default=None, help="Stop after this long (25s).  [default: to the end]"
)
def command(data: Path | None, for_: str | None) -> None:
    """Drive the G1 in MuJoCo with a motion, record it, check it and run its policy again.

    Without upstream data ($STATION_ASSETS) there is no policy to walk with yet: then the command half alone runs.
    """
    from station import config
    from station.cli import up
    from station.episode.folder import data_folder
    from station.life import runbook as runbooks
    from station.life.session import Recording

    is_whole = assets.root() is not None
    if not is_whole:
        click.echo(
            f"${assets.ENVIRONMENT_VARIABLE} is not set, so there is no policy and no robot model: only the command "
            "half runs (motion, bus, recorder). docs/assets.md says how to get the rest.",
            err=True,
        )
    book = runbooks.load(runbooks.find("g1-sim-motion" if is_whole else "commands-only"))
    seconds = None if for_ is None else config.seconds(for_, where="--for")
    recording = Recording(task="demo", instruction="follow the motion")
    code, episode = up.run(book, bus=None, data=data_folder(data), recording=recording, unattended=True, for_s=seconds)
    if episode is None:
        raise StationError("the demo recorded nothing; the lines above say why")
    code = _report(episode, is_whole=is_whole) or code
    raise SystemExit(code)


def _report(episode: Path, *, is_whole: bool) -> int:
    from station.cli.audit import print_audit
    from station.cli.report import print_quality
    from station.episode.audit import audit
    from station.episode.check import check, write_measured
    from station.episode.reader import open_episode

    click.echo()
    reader = open_episode(episode)
    quality = check(reader)
    write_measured(episode, quality)
    print_quality(quality)
    if not is_whole:
        return 0 if sum(stream.lost for stream in quality.streams) == 0 else 1
    click.echo()
    found = audit(reader)
    print_audit(found)
    click.echo(f"\nnext: station replay {episode} --to rerun     station episodes show {episode}")
    return 0 if found.is_equal and quality.verdict != "reject" else 1
