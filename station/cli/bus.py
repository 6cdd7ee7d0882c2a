"""``station bus``: the Redis server itself."""

from __future__ import annotations

import json
import signal
import threading

import click

from station.cli.options import Verbs, address_of, bus_option, json_option
from station.errors import BusError


@click.group("bus", cls=Verbs)
def command() -> None:
    """Start a bus, or look at one."""


@command.command("start")
@click.option("--tcp", "tcp_port", type=click.IntRange(1, 65535), default=None,
              help="Open this loopback port too, so that stock scripts connect (theirs is 6379).")  # fmt: skip
def start(tcp_port: int | None) -> None:
    """Run a bus in this terminal until it is interrupted."""
    from station.bus.discovery import own_options
    from station.bus.redis_server import RedisServer

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with RedisServer.start(own_options(tcp_port)) as server:
        click.echo(f"bus {server.address} (pid {server.pid}); every station command of yours finds it by itself")
        if tcp_port is not None:
            click.echo(f"stock scripts: redis://localhost:{tcp_port}/0")
        click.echo("Ctrl-C stops it")
        while not stop.wait(0.5):
            if not server.is_running:
                raise BusError(f"bus {server.address}: its server (pid {server.pid}) has died; start it again")


@command.command("info")
@bus_option
@json_option
def info(bus: str | None, as_json: bool) -> None:
    """Tell which server a bus is and how it is set up."""
    from station.bus.client import Bus

    with Bus(address_of(bus), name="cli", timeout_s=1.0) as line:
        text = line.call("INFO").decode()
        fields = dict(row.split(":", 1) for row in text.splitlines() if ":" in row)
    wanted = (
        "valkey_version", "redis_version", "process_id", "uptime_in_seconds", "connected_clients", "connected_slaves",
        "used_memory_human", "maxmemory_policy", "repl_backlog_size", "total_commands_processed",
        "instantaneous_ops_per_sec",
    )  # fmt: skip
    found = {"address": str(line.address)} | {name: fields[name] for name in wanted if name in fields}
    if as_json:
        click.echo(json.dumps(found))
        return
    for name, value in found.items():
        click.echo(f"{name:26} {value}")
