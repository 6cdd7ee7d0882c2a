"""``station console``: a running station in a browser."""

from __future__ import annotations

import io
import logging
import threading
from typing import Any

import click
import msgspec

from station import config, libraries, python_child, registry
from station.cli import log_lines
from station.cli.options import address_of, bus_option, data_option, set_option
from station.errors import BusError

log = logging.getLogger(__name__)


@click.command("console")
@click.option("--host", default=None, metavar="ADDRESS",
              help="Serve other machines too, on this address of ours, with TLS.  [default: this machine]")  # fmt: skip
@click.option("--port", default=None, type=click.IntRange(0, 65535), help="Port; 0 for any free one.  [default: 8770]")
@click.option("--name", default="", help="Name on the bus, when two consoles run.  [default: console]")
@click.option("--new-links", is_flag=True, help="Make all earlier links and sign-ins void first.")
@set_option("key=value")
@data_option
@bus_option
def command(
    host: str | None, port: int | None, name: str, new_links: bool, sets: tuple[str, ...], data: Any, bus: str | None
) -> None:
    """Show the station that runs, or the next one, in a browser: robot, cameras, curves, episodes, and a stop.

    The page is no safety-rated stop: the robot's own stays within reach.
    """
    libraries.expect("the console", "starlette", "console")
    kind = registry.find("server", "console")
    given = {"host": host, "port": port, "data": None if data is None else str(data)}
    values = config.merged(
        {name: value for name, value in given.items() if value is not None},
        config.overrides(sets, servers=None).get("", {}),
    )
    built = config.build(kind.config, values, where="console (`station settings console` lists them)")
    python_child.write_stacks_when_asked()
    with log_lines.never_waited_for():
        raise SystemExit(_serve(kind, built, bus, name or kind.name, is_new=new_links))


def _serve(kind: Any, built: Any, bus: str | None, name: str, *, is_new: bool) -> int:
    from station.life.serving import for_role, serve
    from station.stop_signals import set_on_signals
    from station.web.console import Console
    from station.web.keyring import Keyring

    if is_new:
        Keyring().renew()
    address, stop = for_role(address_of(bus), kind.role), threading.Event()
    end = set_on_signals(stop, second_interrupts=True)
    with Console(built, address, name) as console:
        _show(console, is_open=built.is_open)
        # Ctrl-C may come before the server hears it itself.
        shown = msgspec.structs.replace(kind, main=lambda _, life: 0 if stop.is_set() else console.serve(life))
        try:
            while console.wait_for_bus(stop):
                try:
                    return serve(shown, built, address=address, name=name)
                except BusError as error:  # it went as the server began
                    log.warning("%s; waits for the next", error)
                    end()  # the server that did not begin has the signals
                    end = set_on_signals(stop, second_interrupts=True)
            return 0
        finally:
            end()


def _show(console: Any, *, is_open: bool) -> None:
    click.echo(f"operator: {console.link('operator')}")
    click.echo(f"viewer:   {console.link('viewer')}   (looks on; may stop)")
    if console.authority is not None:
        click.echo(f"A phone trusts the page once it has the authority: {console.authority}")
    if is_open:
        import segno

        drawn = io.StringIO()
        segno.make(console.link("viewer")).terminal(out=drawn, compact=True)
        click.echo("the viewer's link for a phone:")
        click.echo(drawn.getvalue())
    click.echo("Whoever has a link may use it; the page is no safety-rated stop. Ctrl-C ends the console.")
