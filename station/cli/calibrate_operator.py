"""``station devices calibrate DEVICE``, for a device that sees the operator's body: the body is measured, and kept."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.cli.options import bus_option, set_option
from station.cli.tables import Column, plain, print_table
from station.errors import StationError, UsageError
from station.operator.measure import MeasurementResult, OperatorMeasure
from station.printable import printable

if TYPE_CHECKING:
    from station.bus.client import Bus

MEASURE_S = 2.0
_STARTS_WITHIN_S = 30.0
_ATTEMPTS = 5  # of somebody who is there to try again
_USUAL_COUNT = 5


def verb(device: str, measure: OperatorMeasure) -> click.Command:
    """Return the verb for a device."""

    def run(operator: str, pose: str, yes: bool, **rest: Any) -> None:
        _run(device, measure, operator, pose, yes=yes, **rest)

    poses = list(measure.poses)
    about = "\n\n".join([
        "Measure the operator who wears this device, and keep it by name.",
        "The operator stands still for two seconds; lengths of the body, the floor and the frames of the trackers are "
        "found of that. It listens to the device's server where one runs, and else starts one, with --set fake=FILE on "
        "a fake.",
        *(f"--pose {name}: {words}." for name, words in measure.poses.items()),
    ])  # fmt: skip
    options = (
        click.option("--operator", required=True, metavar="NAME", help="Who is measured; a file of that name is kept."),
        click.option("--pose", type=click.Choice(poses), default=poses[0], show_default=True, help="How to stand."),
        click.option("--yes", is_flag=True, help="Ask nothing: count down at once, and replace what was kept before."),
        click.option("--count", type=click.IntRange(0, 60), default=_USUAL_COUNT, show_default=True,
                     help="Seconds to count down."),
        click.option("--within", "within_s", type=click.FloatRange(1.0, 600.0), default=30.0, show_default=True,
                     help="Seconds to wait for a body that is tracked."),
        click.option("--server", default=device, show_default=True, help="Name of the device's server on the bus."),
        set_option("key=value"),
        bus_option,
    )  # fmt: skip
    for option in reversed(options):
        run = option(run)
    return click.command(device, help=about)(run)


def _run(
    device: str, measure: OperatorMeasure, operator: str, pose: str, *, yes: bool, count: int, within_s: float,
    server: str, sets: tuple[str, ...], bus: str | None,
) -> None:  # fmt: skip
    from station.operator.gather import Gatherer

    file = measure.file(operator)
    if not (yes or sys.stdin.isatty()):
        raise UsageError(f"devices calibrate {device}: there is no terminal to ask in; --yes measures without asking")
    with _device(device, server, sets, bus) as (line, look), Gatherer(line, server) as gatherer:
        gatherer.wait_for(measure.why_not, within_s, lambda why: click.echo(f"waiting: {printable(why)}"), look)
        click.echo(f"{operator}: {measure.poses[pose]}")
        source = _source(line, server)

        def once() -> MeasurementResult:
            _count_down(count, waits=not yes)
            readings = gatherer.gather(measure.why_not, MEASURE_S)
            return measure.measure(readings, operator, pose, device=device, source=source)

        measured = _until_it_works(once, 1 if yes else _ATTEMPTS)
    _show(measured)
    if file.exists() and not yes and not click.confirm(f"{file} is there; replace it?"):
        raise click.Abort
    click.echo(f"\nkept: {measure.keep(measured)}")
    click.echo(f"to go by it: station up … {measure.how_to_use(operator)}")


@contextmanager
def _device(
    device: str, server: str, sets: tuple[str, ...], bus: str | None
) -> Iterator[tuple[Bus, Callable[[], None]]]:
    """Give the bus on which the device's server speaks, started where none does, and what sees that it still runs."""
    from station.bus import address as addresses
    from station.bus.client import Bus
    from station.bus.discovery import found_or_started
    from station.life.server import read_health

    named = addresses.parse(bus) if bus else None
    with found_or_started(named) as address, Bus(address, name="calibrate", timeout_s=1.0) as line:
        if any(health.name == server and health.is_alive for health in read_health(line)):
            if sets:
                raise UsageError(f"--set {sets[0]}: server {server!r} runs already and is listened to; stop it first")
            click.echo(f"listening to {server} on {address}")
            yield line, lambda: None
            return
        with _started(device, server, sets, line) as look:
            yield line, look


@contextmanager
def _started(device: str, server: str, sets: tuple[str, ...], line: Bus) -> Iterator[Callable[[], None]]:
    from station import config, registry
    from station.life.server import ServerKind
    from station.supervision.supervisor import Supervisor, log_folder

    kind: ServerKind = registry.find("server", device)
    given = config.overrides(sets, servers=None).get("", {})
    built = config.build(kind.config, given, where=f"--set of the {device} server")
    supervisor = Supervisor(line, log_folder(line.address))
    try:
        supervisor.spawn(server, built, server=device)
        supervisor.wait_for(server, "inactive", _STARTS_WITHIN_S)
        supervisor.activate(server)
        supervisor.wait_for(server, "active", _STARTS_WITHIN_S)

        def poll() -> None:
            supervisor.wait_for(server, "active", _STARTS_WITHIN_S)  # at once; raises with its last words if it died

        yield poll
    finally:
        supervisor.stop_all()


def _count_down(seconds: int, *, waits: bool) -> None:
    """Let the operator get into the pose; each second is heard by somebody in a headset as well."""
    if waits:
        click.prompt(click.style("Enter when ready", bold=True), default="", show_default=False, prompt_suffix=" ")
    bell = "\a" if sys.stdout.isatty() else ""
    for left in range(seconds, 0, -1):
        click.echo(f"{bell}{left} … ", nl=False)
        time.sleep(1.0)
    click.echo(f"{bell}stand still")


def _until_it_works(once: Callable[[], MeasurementResult], attempts: int) -> MeasurementResult:
    """Measure, again after what an operator can do better."""
    for _ in range(attempts - 1):
        try:
            return once()
        except UsageError:
            raise
        except StationError as error:
            click.echo(f"{printable(str(error))}; once more")
    return once()


def _show(measured: MeasurementResult) -> None:
    click.echo(f"\n{measured.about}")
    columns = [Column(title, "left" if index == 0 else "right") for index, title in enumerate(measured.titles)]
    print_table(columns, [tuple(map(plain, row)) for row in measured.rows])
    click.echo(measured.note)


def _source(line: Bus, server: str) -> str:
    """Return in words what the server reads: its library and service, or the script of its fake."""
    from station.bus import codec, keys

    facts = codec.parse_facts(line.get(keys.server_config(server)))
    config, told = facts.get("config"), facts.get("device")
    if isinstance(config, dict) and config.get("fake"):
        return f"a fake that plays {Path(str(config['fake'])).name}"
    return ", ".join(f"{name} {value}" for name, value in told.items()) if isinstance(told, dict) else server
