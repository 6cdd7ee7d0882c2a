"""``station down``: end a station from another terminal."""

from __future__ import annotations

import contextlib
import os
import signal
import time

import click

from station.cli.options import address_of, bus_option
from station.errors import NotReady

_LOOK_S, _TELL_S, _WITHIN_S = 0.1, 5.0, 60.0


@click.command("down")
@bus_option
def command(bus: str | None) -> None:
    """End every `station up` of this machine on the bus: robots return to standing, the episode is closed.

    It is what Ctrl-C in its terminal does, and is waited for. Where none runs, there is nothing to do. A server that
    was started by hand, with `station serve`, is left alone.
    """
    from station.supervision import claims

    address = address_of(bus)
    found = claims.stations(address)
    time.sleep(_LOOK_S)  # one that has just begun may not have written its id over that of one that has ended
    found = {pid: servers for pid, servers in found.items() if pid in claims.stations(address)}
    if not found:
        click.echo(f"no `station up` of this machine runs on {address}", err=True)
    for pid, servers in found.items():
        click.echo(f"ending the station with pid {pid}: {', '.join(servers)}", err=True)
        with contextlib.suppress(ProcessLookupError):  # it has just ended
            os.kill(pid, signal.SIGTERM)
    began_s = told_s = time.monotonic()
    while left := [pid for pid in found if pid in claims.stations(address)]:
        now_s = time.monotonic()
        if now_s - began_s > _WITHIN_S:
            raise NotReady(
                f"the station with pid {left[0]} has not ended within {_WITHIN_S:.0f} s; "
                "its terminal, or `station logs`, says why"
            )
        if now_s - told_s > _TELL_S:
            click.echo(f"still waiting for pid {', '.join(map(str, left))}: it closes its episode first", err=True)
            told_s = now_s
        time.sleep(_LOOK_S)
