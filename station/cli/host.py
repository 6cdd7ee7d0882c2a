"""``station host``: machines whose servers a station on another one starts."""

from __future__ import annotations

import click

from station.cli import candidates
from station.cli.options import Verbs, address_of, bus_option, json_option


@click.group("host", cls=Verbs)
def command() -> None:
    """Let a station on another machine start servers here, or list the machines that do."""


@command.command("join")
@click.option("--name", default="", help="What runbooks and `--on` call this machine.  [default: its host name]")
@click.option("--allow", metavar="SERVER", multiple=True, shell_complete=candidates.registered("server"),
              help="Start servers of this kind alone; may be repeated.  [default: all that are installed]")  # fmt: skip
@bus_option
def join(name: str, allow: tuple[str, ...], bus: str | None) -> None:
    """Run the agent of this machine, until it is interrupted: `station up` elsewhere starts servers here.

    Who may write to the bus may then start servers of this user here, with settings of their choice and no command of
    their own; --allow says which. They finish when the station ends, when nothing is heard of it for 15 s, and with the
    agent. Episodes go to the data folder of this machine ($STATION_DATA, else ./data).
    """
    import socket

    from station import config, python_child
    from station.cli import log_lines
    from station.life.serving import serve
    from station.supervision import agent, hosts

    values = {"host": name or socket.gethostname().partition(".")[0], "allow": list(allow)}
    built = config.build(agent.AgentConfig, values, where="station host join")
    python_child.write_stacks_when_asked()
    with log_lines.never_waited_for():
        code = serve(agent.KIND, built, address=address_of(bus), name=hosts.agent_name(built.host))
    raise SystemExit(code)


@command.command("list")
@json_option
@bus_option
def listed(as_json: bool, bus: str | None) -> None:
    """List the machines that have joined the bus, and the servers that run there."""
    import msgspec

    from station.bus.client import Bus
    from station.supervision import hosts

    with Bus(address_of(bus), name="host", timeout_s=1.0) as line:
        found = hosts.joined(line)
    if as_json:
        click.echo(msgspec.json.encode(found))
        return
    if not found:
        click.echo("no machine has joined this bus; on each, run: station host join", err=True)
    for name, facts in found.items():
        running = [server for server, each in facts.servers.items() if each.code is None]
        servers = f"{', '.join(running) or 'nothing yet'} for {facts.who}" if facts.who else "nothing"
        click.echo(f"{name}: runs {servers}; version {facts.version}, {facts.free_gb:.0f} GB free at {facts.data}")
