"""``station pair``: how a headset, a phone or another browser is let in to the pages that run here."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator, Mapping
from typing import Any

import click

from station import libraries
from station.bus import codec, keys, stamp
from station.bus.client import Bus
from station.cli.options import address_of, bus_option
from station.errors import NotReady
from station.life.server import Health, read_health
from station.printable import printable

_LONGEST = 300  # characters of an address


@click.command("pair")
@click.argument("server", default="")
@click.option("--qr", is_flag=True, help="Draw each link for a phone's camera.")
@bus_option
def command(server: str, qr: bool, bus: str | None) -> None:
    """Print address, code and link of each page that is served here, or of SERVER's.

    The code is typed on the page; it is good for five minutes at least. Who has it, or the link, is an operator.
    """
    libraries.expect("a page", "starlette", "console")
    from station.web import certificates, keyring, links

    with Bus(address_of(bus), name="pair") as line:
        found = [(health, page) for health, page in _pages(line) if server in ("", health.name)]
        where = line.address
    if not found:
        what = f"no server {server!r} serves a page" if server else "no page is served"
        raise NotReady(f"{what} on {where}; start one: `station console`, or a runbook with a webxr server")
    ring, now_s = keyring.Keyring(), time.time()
    code = ring.code(now_s)
    for health, page in found:
        if health.boot != stamp.boot_id():
            click.echo(f"{health.name}: {page}  (served by {health.host}: `station pair` there prints its code)")
            continue
        link = links.link(page, ring, "operator")
        click.echo(f"{health.name}: {page}")
        click.echo(f"  code {code[:4]} {code[4:]}  (another one in {_minutes(now_s, keyring.CODE_S)}; this one counts"
                   " five minutes more)")  # fmt: skip
        click.echo(f"  link {link}")
        if page.startswith("https:") and certificates.authority().is_file():
            click.echo(f"  a browser that is to trust it needs the authority {certificates.authority()}")
        if qr:
            click.echo(_drawn(link))


def _pages(bus: Bus) -> Iterator[tuple[Health, str]]:
    """Yield the servers that live and serve a page, with its address."""
    now_ns = bus.clock.wall_ns()
    for health in read_health(bus):
        if health.is_alive_at(now_ns):
            page = page_of(bus.get(keys.server_config(health.name)))
            if page:
                yield health, page


def page_of(stated: bytes | None) -> str:
    """Return the address of the page that a server serves, by what it states; "" for none."""
    facts = codec.parse_facts(stated)
    device = facts.get("device")
    page = facts.get("url") or (device.get("page") if isinstance(device, Mapping) else None)
    return printable(page, _LONGEST) if isinstance(page, str) else ""


def _minutes(now_s: float, every_s: float) -> str:
    left_s = every_s - now_s % every_s
    return f"{left_s / 60.0:.0f} min" if left_s >= 90.0 else f"{left_s:.0f} s"


def _drawn(link: str) -> str:
    import segno

    drawn: Any = io.StringIO()
    segno.make(link).terminal(out=drawn, compact=True)
    return str(drawn.getvalue())
