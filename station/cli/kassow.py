"""``station kassow``: look after an arm's controller, simulate one, show its traps."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station import registry
from station.bus.client import Bus
from station.cli.options import NamedPath, Verbs, address_of, bus_option
from station.control.arm_kind import ArmServerKind
from station.errors import UsageError
from station.life import controller_request
from station.life.controller_request import Action
from station.stop_signals import set_on_signals

if TYPE_CHECKING:
    from station_kord.demonstrations import Course

FAULTS = ("fetch-first", "stop-point", "hold-flood", "no-throttle", "short-time")
"""The demonstrations of `station_kord.demonstrations`, which need not be installed to be named."""

_robot_option = click.option(
    "--robot",
    default=lambda: registry.find("family", "kassow").names[0],
    show_default="that of the KR810",
    help="Suffix of the arm's keys; holds its model.",
)


@click.group("kassow", cls=Verbs)
def command() -> None:
    """Look after the controller of a Kassow arm, or simulate one."""


@command.command("clear")
@_robot_option
@bus_option
def clear(robot: str, bus: str | None) -> None:
    """Clear the faults of the controller, once their cause is gone.

    Nothing moves afterwards: old targets are forgotten, and the commander has to let go and engage anew. What only a
    person at the controller can confirm (an emergency stop) has to be confirmed there first.
    """
    _ask(bus, robot, "clear")
    click.echo(f"{robot}: no fault any more; engage anew to drive")


@command.command("profile")
@click.argument("name")
@_robot_option
@bus_option
def profile(name: str, robot: str, bus: str | None) -> None:
    """Track targets by the profile NAME from now on; the arm has to stand.

    speed125 (default), time125, time250, legacy-stop (simulation only); docs/kassow.md tells them apart.
    """
    _ask(bus, robot, "profile", profile=name)
    click.echo(f"{robot}: profile {name}")


@command.command("throttle")
@click.argument("ticks", type=click.IntRange(1, 250))
@_robot_option
@bus_option
def throttle(ticks: int, robot: str, bus: str | None) -> None:
    """Send a target on every TICKS-th tick of 4 ms at most, from now on, also in motion; 2 is 125 Hz."""
    _ask(bus, robot, "throttle", throttle=ticks)
    click.echo(f"{robot}: {250 / ticks:g} targets a second at most")


def _bridge() -> Any:
    """Return the native package of the arm's server, which holds the simulated controller."""
    kind: ArmServerKind = registry.find("server", "kassow")
    return kind.bridge()


def _ask(bus: str | None, robot: str, action: Action, *, profile: str = "", throttle: int = 0) -> None:
    with Bus(address_of(bus), name="kassow", timeout_s=1.0) as line:
        controller_request.ask(line, robot, action, profile=profile, throttle=throttle)


@command.command("controller")
@click.option("--socket", "socket", required=True, type=NamedPath(dir_okay=False, path_type=Path),
              help="Socket to listen at; the server's setting is then host=unix:PATH.")  # fmt: skip
@click.option("--q-start", "q_start", default="0 0.35 0 1.6 0 1.19 0", show_default=True, metavar="RAD",
              help="Seven joints that the arm starts from.")  # fmt: skip
@click.option("--preset", type=click.Choice(["final", "narrative"]), default="final", show_default=True,
              help="What planning a target by speed costs; with narrative 125 Hz overflows in 25 s.")  # fmt: skip
def controller(socket: Path, q_start: str, preset: str) -> None:
    """Run a simulated controller in a process of its own, until Ctrl-C.

    Whatever happens to the arm's server, this arm goes on by its controller's rules; a server that is started again
    finds it where it stopped.
    """
    if socket.exists() and not socket.is_socket():
        raise UsageError(f"--socket {socket}: expected a socket or a new name, got a file; name another")
    native = _bridge()
    try:
        options = native.SimOptions(preset=preset, q_start=[float(word) for word in q_start.split()])
        server = native.ControllerServer(socket, options)
        server.start()
    except ValueError as error:  # BadOption is one, too
        raise UsageError(f"controller: {error}") from None
    ended = threading.Event()
    set_on_signals(ended)
    click.echo(f"simulated controller at unix:{socket}; Ctrl-C ends it")
    try:
        ended.wait()
    finally:
        server.stop()


@command.command("demo-fault")
@click.argument("name", type=click.Choice(FAULTS))
@click.option("-o", "--output", type=NamedPath(dir_okay=False, path_type=Path), default=None,
              help="Where to draw it.  [default: kassow-NAME.png]")  # fmt: skip
def demo_fault(name: str, output: Path | None) -> None:
    """Let a simulated controller fail in one of the ways that streaming to it can fail, and cure it.

    Runs twice in exact virtual time, once with the mistake and once with the one setting that cures it, and draws
    target, arm, queue and sends of both over time.
    """
    _bridge()  # says what to do where it is not installed
    from station_kord import demonstrations

    from station.view import fault_plot

    shown = demonstrations.find(name)
    faulty, cured = shown.run()
    path = fault_plot.save(shown, faulty, cured, output or Path(f"kassow-{name}.png"))
    click.echo(shown.symptom)
    for course in (faulty, cured):
        click.echo(f"  {course.setting:48} {_outcome(course)}")
    click.echo(f"Cure: {shown.cure}")
    click.echo(str(path))


def _outcome(course: Course) -> str:
    parts = [f"{course.sends} targets sent"]
    if course.event_s is not None:
        parts.insert(0, f"{course.event} ({course.event_s:.3f} s after the start)")
    else:
        parts.insert(0, "no event")
    parts.append(f"moves on for {course.still_moves_s:.2f} s after letting go")
    return "; ".join(parts)
