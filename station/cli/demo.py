"""``station demo``: a simulated G1 walks, is recorded, checked and drawn; needs nothing but this package."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station import libraries
from station.cli.options import bus_option, data_option, set_option
from station.errors import StationError

if TYPE_CHECKING:
    from station.episode.reading.reader import EpisodeReader

RUNBOOK = "g1-demo"

_INTERRUPTED = 130


@click.command("demo")
@click.option(
    "--for", "for_", metavar="DURATION", default=None, help="Stop after this long (25s).  [default: to the end]"
)
@set_option("server.key=value")
@data_option
@bus_option
def command(for_: str | None, sets: tuple[str, ...], data: Path | None, bus: str | None) -> None:
    """Drive a simulated G1 through the built-in clips, record it, check it, run its policy again, and draw it.

    \b
    station demo                                     a tour of about a minute
    station demo --set motion.motion=builtin:bow     one clip
    station demo --set g1.policy=twist2              another policy

    It is the runbook g1-demo; `station up g1-demo --dry-run` prints it.
    """
    from station import config
    from station.cli import up
    from station.episode.storage.folder import data_folder
    from station.supervision import runbook as runbooks
    from station.supervision.session import Recording

    book = runbooks.load(runbooks.find(RUNBOOK), sets)
    book.expect_found()
    seconds = None if for_ is None else config.seconds(for_, where="--for")
    gl = _leave_drawing_to_the_end()
    recording = Recording(task="demo", instruction="follow the motion")
    code, episode = up.run(
        book, bus=bus, data=data_folder(data), recording=recording, unattended=True, for_s=seconds, is_brief=True
    )
    if not episode and code != _INTERRUPTED:
        raise StationError("the demo recorded nothing; the lines above say why")
    if episode:
        code = _report(Path(episode), gl, data) or code
    raise SystemExit(code)


def _leave_drawing_to_the_end() -> str:
    """Keep MuJoCo from looking for OpenGL in this process and its servers; return how it was to draw.

    Where OpenGL is broken, or ``$MUJOCO_GL`` names what is not there, MuJoCo cannot even be imported.
    """
    from station.view.offscreen import VARIABLE

    wanted = os.environ.get(VARIABLE, "")
    os.environ[VARIABLE] = "disable"
    return wanted


def _report(episode: Path, gl: str, data: Path | None) -> int:
    """Say on one screen what happened, how good it was, what to open and what to try; return an exit code."""
    from station.cli.audit import in_short
    from station.cli.quality import print_in_short
    from station.episode.quality import rule_file
    from station.episode.quality.check import check, write_measured
    from station.episode.reading.reader import open_episode
    from station.episode.replaying.audit import audit

    click.echo()
    with _busy("measuring the episode"):
        reader = open_episode(episode)
        quality = check(reader, rule_file.of_user())
        write_measured(episode, quality)
    print_in_short(quality)
    with _busy("running the policy again on what was recorded"):
        found = audit(reader)
    click.echo(f"  {in_short(found)}")
    click.echo("\nopen:")
    _draw(reader, episode, gl)
    _print_next_steps(data)
    return 0 if found.is_equal and quality.verdict != "reject" else 1


def _draw(reader: EpisodeReader, folder: Path, gl: str) -> None:
    """Draw the episode in three ways; what cannot be drawn here is said, and costs nothing else."""
    from station.view import names

    def sheet(path: Path) -> object:
        from station.view.contact_sheet import save_sheet

        return save_sheet(reader, path, gl=gl)

    def plot(path: Path) -> object:
        from station.view.plots import save_plot

        return save_plot(reader, path)

    def rrd(path: Path) -> object:
        from station.view.episode_rrd import save

        return save(reader, path)

    _made("contact sheet", folder / names.CONTACT_SHEET, sheet)
    _made("plot", folder / names.PLOT, plot)
    _made("Rerun file", folder / names.RERUN, rrd)


def _made(name: str, path: Path, make: Callable[[Path], object]) -> None:
    try:
        with _busy(f"drawing the {name}"):
            make(path)
    except StationError as error:
        click.echo(f"  {name} skipped: {error}")
    else:
        click.echo(f"  {name:<14} {path}")


def _print_next_steps(data: Path | None) -> None:
    where = "" if data is None else f" --data {data}"
    tries = {f"station up g1-demo --yes --record --task mine{where}": "record a task of your own"}
    if libraries.version("starlette") is not None:
        tries[f"station up g1-demo --yes --console{where}"] = (
            "watch, stop and record in a browser: http://127.0.0.1:8770"
        )
    if shutil.which("station") is None:  # `make demo` runs it from an environment that this shell has not entered
        tries = {f". {os.path.relpath(Path(sys.executable).parent / 'activate')}": "put `station` on the path"} | tries
    width = max(len(text) for text in tries)
    click.echo("\ntry:")
    for text, why in tries.items():
        click.echo(f"  {text:<{width}}   {why}")
    click.echo(f"\nall figures: station check latest{where}   all curves: station view latest{where}")


@contextmanager
def _busy(what: str) -> Iterator[None]:
    """Show in a terminal what takes a moment."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(f"[dim]{what} …[/]"):
        yield
