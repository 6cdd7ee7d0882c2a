"""``station replay``: an episode again, to a bus, a simulation or Rerun."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from station.cli.options import NamedPath, bus_option, data_option, episode_argument, json_option
from station.stop_signals import set_on_signals

if TYPE_CHECKING:
    from station.episode.reading.reader import EpisodeReader


@click.command("replay")
@episode_argument
@click.option("--to", "target", type=click.Choice(["bus", "sim", "rerun"]), required=True, help="Where to.")
@click.option("--speed", default=1.0, show_default=True, help="Times the recorded speed (bus).")
@click.option(
    "--role", "roles", multiple=True, help="Only keys of this role: command, state, policy, … (bus); may repeat."
)
@click.option("--allow-live", is_flag=True, help="Send commands even where a robot is being driven (bus).")
@click.option("--save", "save_as", type=NamedPath(dir_okay=False, path_type=Path), default=None,
              help="Write this .rrd file instead of opening the viewer (rerun).")  # fmt: skip
@click.option("--robot-model", default=None, help="MJCF to draw.  [default: the one that was recorded] (rerun)")
@data_option
@bus_option
@json_option
def command(
    episode: str, target: str, speed: float, roles: tuple[str, ...], allow_live: bool, save_as: Path | None,
    robot_model: str | None, data: Path | None, bus: str | None, as_json: bool,
) -> None:  # fmt: skip
    """Replay EPISODE.

    \b
    bus    same bytes, same order, original timeline; commands alone, eased in, where a robot is driven
    sim    the recorded commands through a fresh simulation; tells how it differs from the recorded run
    rerun  robot, command and state curves with names, events
    """
    from station.episode.reading.reader import open_episode

    reader = open_episode(episode, data)
    if target == "bus":
        _to_bus(reader, bus, speed, roles, allow_live, as_json)
    elif target == "sim":
        _to_sim(reader, as_json)
    else:
        _to_rerun(reader, save_as, robot_model, as_json)


def _to_bus(
    reader: EpisodeReader, bus: str | None, speed: float, roles: tuple[str, ...], allow_live: bool, as_json: bool
) -> None:
    from station.cli.options import address_of
    from station.episode.replaying.replay import to_bus

    stop = threading.Event()
    set_on_signals(stop)
    report = to_bus(reader, address_of(bus), speed=speed, roles=roles or None, allow_live=allow_live, stop=stop)
    if as_json:
        click.echo(msgspec.json.encode(report))
    else:
        click.echo(
            f"{report.messages} messages in {report.moments} writes to {report.bus} in {report.seconds:.1f} s "
            f"(roles: {', '.join(report.roles)}; {report.skipped} left out, {report.lost} not taken)"
        )
        late = (report.lateness_p50_s * 1e3, report.lateness_p99_s * 1e3, report.lateness_max_s * 1e3)
        click.echo("late by {:.2f} ms (median), {:.2f} ms (p99), {:.2f} ms (worst)".format(*late))
        if not report.is_complete:
            click.echo("stopped before the end", err=True)
    raise SystemExit(0 if report.is_complete and not report.lost else 1)


def _to_sim(reader: EpisodeReader, as_json: bool) -> None:
    from station.episode.replaying.resimulate import to_sim

    report = to_sim(reader)
    if as_json:
        click.echo(msgspec.json.encode(report))
    else:
        if (count := report.without_state) == 1:
            click.echo("1 step not compared: the state before it was not recorded")
        elif count:
            click.echo(f"{count} steps not compared: the states before them were not recorded")
        click.echo(
            f"{report.steps} steps, {report.different} differ; "
            f"greatest difference {report.max_q_difference_rad:.3g} rad"
            + ("" if report.max_root_difference_m is None else f", root {report.max_root_difference_m:.3g} m")
            + f"; fell: {'yes' if report.fell else 'no'} (recorded: {report.recorded_falls})"
        )
        if report.different and not report.lock_step:
            click.echo(
                "recorded against the clock: which command met which physics step was chance, so some drift is natural"
            )
        if not report.steps:
            click.echo("station: no step could be compared", err=True)
        for note in report.notes:
            click.echo(f"not as recorded: {note}")
    raise SystemExit(1 if not report.steps or (report.lock_step and report.different) else 0)


def _to_rerun(reader: EpisodeReader, save_as: Path | None, robot_model: str | None, as_json: bool) -> None:
    from station.view import episode_rrd

    if save_as is None:
        view = episode_rrd.show(reader, robot_model=robot_model)
    else:
        view = episode_rrd.save(reader, save_as, robot_model=robot_model)
    if as_json:
        click.echo(msgspec.json.encode(view))
        return
    for warning in view.warnings:
        click.echo(f"station: {warning}", err=True)
    where = f"saved {view.path}; open it with: rerun {view.path}" if view.path else "shown in the viewer"
    click.echo(f"{view.episode_id}: {view.poses} poses, {len(view.curves)} curves, {view.events} events; {where}")
