"""``station view``: a running station in Rerun; or an episode, there and as pictures."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.cli import candidates
from station.cli.options import NamedPath, address_of, bus_option, data_option
from station.errors import StationError, UsageError
from station.stop_signals import set_on_signals

if TYPE_CHECKING:
    import rerun as rr

    from station.episode.reading.reader import EpisodeReader

_IN_ITS_FOLDER = ""  # FILE was left out


@click.command("view")
@click.argument("episode", required=False, shell_complete=candidates.episodes)
@click.option("--save", "save_as", type=NamedPath(dir_okay=False, path_type=Path), default=None,
              help="Write this .rrd file instead of opening the viewer; needs no display.")  # fmt: skip
@click.option("--contact-sheet", metavar="[FILE]", is_flag=False, flag_value=_IN_ITS_FOLDER, default=None,
              help="Draw moments of EPISODE as PNG; without FILE in its folder.")  # fmt: skip
@click.option("--plot", metavar="[FILE]", is_flag=False, flag_value=_IN_ITS_FOLDER, default=None,
              help="Draw command against state of EPISODE as PNG; without FILE in its folder.")  # fmt: skip
@click.option("--for", "for_", metavar="DURATION", default=None, help="Stop after this long (live).  [default: Ctrl-C]")
@click.option("--robot", default="", help="Suffix of the robot.  [default: one that is driven, or writes a state]")
@click.option("--robot-model", default=None, help="MJCF to draw.  [default: the one that its server names]")
@data_option
@bus_option
def command(
    episode: str | None, save_as: Path | None, contact_sheet: str | None, plot: str | None, for_: str | None,
    robot: str, robot_model: str | None, data: Path | None, bus: str | None,
) -> None:  # fmt: skip
    """Show a running station live, robot, reference and every named curve; or EPISODE, also as pictures.

    \b
    station view                                   what runs now
    station view latest                            an episode
    station view latest --contact-sheet --plot     the same as two pictures, in its folder
    """
    pictures = {"--contact-sheet": contact_sheet, "--plot": plot}
    asked = [option for option, file in pictures.items() if file is not None]
    if episode is None:
        if asked:
            raise UsageError(f"{asked[0]} draws an episode; name it first: station view EPISODE {asked[0]} [FILE]")
        _show_live(save_as, for_, robot, robot_model, bus)
        return
    if for_ is not None or bus is not None:
        raise UsageError(f"--{'for' if for_ is not None else 'bus'} is for a running station, not for an episode")
    for option in asked:
        _expect_png(option, pictures[option] or "")
    _show_episode(episode, data, save_as, contact_sheet, plot, robot, robot_model)


def _expect_png(option: str, file: str) -> None:
    if file != _IN_ITS_FOLDER and Path(file).suffix.lower() != ".png":
        raise UsageError(f"{option} {file}: expected a file that ends in .png; an episode is named before {option}")


def _show_episode(
    episode: str, data: Path | None, save_as: Path | None, contact_sheet: str | None, plot: str | None,
    robot: str, robot_model: str | None,
) -> None:  # fmt: skip
    from station.episode.reading.reader import open_episode
    from station.episode.reading.steps import robots_of
    from station.view import names, phases

    reader = open_episode(episode, data)
    robot = phases.robot_of(reader, robot)
    if others := [name for name in robots_of(reader) if name != robot]:
        click.echo(f"shows {robot}; by --robot also {', '.join(others)}", err=True)
    if contact_sheet is not None:
        from station.view.contact_sheet import save_sheet

        path = Path(contact_sheet or reader.folder / names.CONTACT_SHEET)
        _warn(save_sheet(reader, path, robot=robot, robot_model=robot_model))
        click.echo(f"saved {path}")
    if plot is not None:
        from station.view.plots import save_plot

        click.echo(f"saved {save_plot(reader, Path(plot or reader.folder / names.PLOT), robot=robot)}")
    if save_as is not None or (contact_sheet is None and plot is None):
        _show_in_rerun(reader, save_as, robot, robot_model)


def _show_in_rerun(reader: EpisodeReader, save_as: Path | None, robot: str, robot_model: str | None) -> None:
    from station.view import episode_rrd

    if save_as is None:
        view = episode_rrd.show(reader, robot=robot, robot_model=robot_model)
    else:
        view = episode_rrd.save(reader, save_as, robot=robot, robot_model=robot_model)
    _warn(view.warnings)
    click.echo(f"saved {view.path}; open it with: rerun {view.path}" if view.path else "shown in the viewer")


def _show_live(save_as: Path | None, for_: str | None, robot: str, robot_model: str | None, bus: str | None) -> None:
    import rerun as rr

    from station import config
    from station.bus.client import Bus
    from station.view.live import LiveView, run
    from station.view.viewer import expect_display

    if save_as is None:
        expect_display()
    stop = threading.Event()
    if for_ is not None:
        timer = threading.Timer(config.seconds(for_, where="--for"), stop.set)
        timer.daemon = True
        timer.start()
    recording = rr.RecordingStream("teleop-station")
    with (
        Bus(address_of(bus), name="view", timeout_s=1.0) as line,
        _shown(recording, save_as, stop),
        LiveView(line, recording, robot=robot, robot_model=robot_model) as view,
    ):
        _warn(view.warnings)
        click.echo(f"showing {view.robot}; Ctrl-C stops", err=True)
        with _signals_set(stop):
            run(view, stop)


@contextmanager
def _shown(recording: rr.RecordingStream, save_as: Path | None, stop: threading.Event) -> Iterator[None]:
    """Send a recording to a file, or to a viewer, whose end sets an event."""
    from station.view.viewer import open_viewer

    if save_as is None:
        with open_viewer(recording, on_end=stop.set) as viewer:
            yield
            if viewer.is_closed:
                click.echo("the viewer was closed", err=True)
            else:
                viewer.deliver(recording)
        return
    try:
        recording.save(save_as)
    except (RuntimeError, OSError) as error:
        raise StationError(f"{save_as}: cannot be written ({error}); name a file in a folder of yours") from error
    yield
    recording.flush()
    click.echo(f"saved {save_as}; open it with: rerun {save_as}")


@contextmanager
def _signals_set(stop: threading.Event) -> Iterator[None]:
    """Have Ctrl-C and SIGTERM set an event; afterwards they are what they were, so a second Ctrl-C ends a wait."""
    end = set_on_signals(stop)
    try:
        yield
    finally:
        end()


def _warn(warnings: list[str]) -> None:
    for warning in warnings:
        click.echo(f"station: {warning}", err=True)
