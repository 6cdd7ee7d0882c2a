"""``station view``: a running station in Rerun."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import click

from station.cli.options import address_of, bus_option
from station.errors import StationError


@click.command("view")
@click.option("--save", "save_as", type=click.Path(dir_okay=False, path_type=Path), default=None,
              help="Write this .rrd file instead of opening the viewer; needs no display.")  # fmt: skip
@click.option("--for", "for_", metavar="DURATION", default=None, help="Stop after this long.  [default: Ctrl-C]")
@click.option("--robot", default="", help="Suffix of the robot.  [default: the one that writes a state]")
@click.option("--robot-model", default=None, help="MJCF to draw.  [default: the one that its server names]")
@bus_option
def command(save_as: Path | None, for_: str | None, robot: str, robot_model: str | None, bus: str | None) -> None:
    """Show the robot, its reference, and every named curve, live."""
    import rerun as rr

    from station import config
    from station.bus.client import Bus
    from station.view.live import LiveView, run

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if for_ is not None:
        timer = threading.Timer(config.seconds(for_, where="--for"), stop.set)
        timer.daemon = True
        timer.start()
    recording = rr.RecordingStream("teleop-station")
    with Bus(address_of(bus), name="view", timeout_s=1.0) as line:
        _open(recording, save_as)
        with LiveView(line, recording, robot=robot, robot_model=robot_model) as view:
            for warning in view.warnings:
                click.echo(f"station: {warning}", err=True)
            click.echo(f"showing {view.robot}; Ctrl-C stops", err=True)
            run(view, stop)
    recording.flush()
    if save_as is not None:
        click.echo(f"saved {save_as}; open it with: rerun {save_as}")


def _open(recording: object, save_as: Path | None) -> None:
    import rerun as rr

    assert isinstance(recording, rr.RecordingStream)
    try:
        if save_as is None:
            recording.spawn()
        else:
            recording.save(save_as)
    except (RuntimeError, OSError) as error:
        raise StationError(f"Rerun cannot start ({error}); without a display use --save FILE.rrd") from error
