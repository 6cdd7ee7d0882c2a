"""``station bus``: the Redis server itself."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.cli import candidates
from station.cli.options import NamedPath, Verbs, address_of, bus_option, json_option
from station.errors import UsageError
from station.stop_signals import set_on_signals

if TYPE_CHECKING:
    from station.bus.address import BusAddress
    from station.bus.client import Bus
    from station.bus.keeper import KeptServer
    from station.bus.server_options import Certificate, ServerOptions
    from station.supervision.runbook import Runbook

_STOCK_PORT = 6379
_FILE = NamedPath(exists=True, dir_okay=False, path_type=Path)


@click.group("bus", cls=Verbs)
def command() -> None:
    """Start a bus, look at one, or say who may do what on one."""


@command.command("start")
@click.option("--tcp", "tcp_port", type=click.IntRange(1, 65535), default=None,
              help="Open this loopback port too, so that stock scripts connect (theirs is 6379).")  # fmt: skip
@click.option("--bind", metavar="ADDRESS", default=None,
              help="Open the port (6379, or that of --tcp) to other machines here, with a password.")  # fmt: skip
@click.option("--acl", "acl_file", metavar="FILE", type=NamedPath(dir_okay=False, path_type=Path), default=None,
              help="Users, and what each may do, in place of one password; see `station bus acl`.")  # fmt: skip
@click.option("--certificate", metavar="FILE", type=_FILE, default=None,
              help="Wrap the port in TLS; needs a server that can (apt install redis-server), and --key.")  # fmt: skip
@click.option("--key", "key_file", metavar="FILE", type=_FILE, default=None, help="Key of the certificate.")
@click.option("--ca", "ca_file", metavar="FILE", type=_FILE, default=None,
              help="Let in only who shows a certificate that this authority signed.")  # fmt: skip
@click.option("--bulk", "has_bulk", is_flag=True,
              help="Start a bulk bus too, for depth and clouds; or that alone, beside your bus that runs.")  # fmt: skip
def start(
    tcp_port: int | None, bind: str | None, acl_file: Path | None, certificate: Path | None, key_file: Path | None,
    ca_file: Path | None, has_bulk: bool,
) -> None:  # fmt: skip
    """Run a bus in this terminal until it is interrupted."""
    from station.bus import address as addresses
    from station.bus.keeper import KeptServer
    from station.bus.redis_server import remove_dead
    from station.bus.server_options import bulk_options

    stop = threading.Event()
    set_on_signals(stop)
    options = _options(tcp_port, bind, acl_file, _certificate(certificate, key_file, ca_file))
    running = _running() if has_bulk else None
    if running is not None:
        _expect_no_servers(running)
        if running.username is not None and acl_file is None:
            raise UsageError(f"bus {running} has users: give the bulk bus the same list, --acl FILE")
        options = replace(options, password=None if acl_file is not None else running.password)
    wanted = [*([] if running is not None else [options]), *([bulk_options(options)] if has_bulk else [])]
    with contextlib.ExitStack() as stack:
        if running is None:
            remove_dead(addresses.bulk_beside(addresses.runtime_folder() / "bus.sock"))
        servers = [stack.enter_context(KeptServer.start(each, on_restart=_tell(each))) for each in wanted]
        if running is None:
            _introduce(servers[0], options)
        if has_bulk:
            _introduce_bulk(servers[-1], wanted[-1])
        click.echo("Ctrl-C stops it" if len(servers) == 1 else "Ctrl-C stops both")
        while not stop.wait(0.5):
            for server in servers:
                if server.error is not None:
                    raise server.error


def _tell(options: ServerOptions) -> Callable[[str], None]:
    which = "" if options.is_urgent else "bulk "
    return lambda text: click.echo(which + text, err=True)


def _running() -> BusAddress | None:
    """Return this user's own bus where it runs already."""
    from station.bus import address as addresses
    from station.bus.connection import Connection, ConnectionLost

    own = addresses.own()
    try:
        Connection(own, timeout_s=1.0).close()
    except ConnectionLost:
        return None
    return own


def _expect_no_servers(address: BusAddress) -> None:
    """Refuse to add a bulk bus under servers that run: a recorder would not hear what is written to it."""
    from station.bus.client import Bus
    from station.errors import Refused
    from station.life.server import read_health

    with Bus(address, name="cli", timeout_s=1.0) as line:
        alive = [health.name for health in read_health(line) if health.is_alive]
    if alive:
        raise Refused(
            f"bus {address}: {', '.join(alive)} would go on without a bulk bus, and a recorder would not hear it; end "
            "them first (`station down`), or start both at once"
        )


def _certificate(file: Path | None, key_file: Path | None, ca_file: Path | None) -> Certificate | None:
    from station.bus.server_options import Certificate

    if file is not None and key_file is not None:
        return Certificate(file=file, key_file=key_file, ca_file=ca_file)
    if any((file, key_file, ca_file)):
        raise UsageError("TLS needs --certificate and --key; --ca beside them asks clients for theirs")
    return None


def _options(
    tcp_port: int | None, bind: str | None, acl_file: Path | None, certificate: Certificate | None
) -> ServerOptions:
    import secrets

    from station.bus import address as addresses
    from station.bus.redis_server import ServerOptions

    folder = addresses.runtime_folder()
    login = None
    if acl_file is not None:
        user, password = addresses.login_of_environment()
        if password is None:
            raise UsageError(
                f"--acl {acl_file}: which of its users are we? Name the file of passwords in "
                f"${addresses.PASSWORD_FILE_VARIABLE} (`station bus acl --passwords FILE` writes it)"
            )
        login = (user or "default", password)
    needs_password = bind is not None and acl_file is None
    return ServerOptions(
        folder=folder,
        socket=folder / "bus.sock",
        tcp_port=tcp_port or (_STOCK_PORT if bind is not None else None),
        bind=bind,
        certificate=certificate,
        password=secrets.token_urlsafe(24) if needs_password else None,
        acl_file=acl_file,
        login=login,
    )


def _introduce(server: KeptServer, options: ServerOptions) -> None:
    from station.bus import password_file
    from station.bus.address import PASSWORD_FILE_VARIABLE

    click.echo(f"bus {server.address} (pid {server.pid}); every station command of yours finds it by itself")
    if options.bind is not None and options.socket is not None:
        scheme, how = ("redis", "in clear text") if options.certificate is None else ("rediss", "encrypted")
        click.echo(f"other machines: {scheme}://{options.bind}:{options.tcp_port}/0, {how}, with a password")
        if options.certificate is not None:
            ours = ", and its own certificate in $STATION_BUS_CERT and $STATION_BUS_KEY"
            click.echo(
                "  each names the authority that signed the bus's certificate in $STATION_BUS_CA"
                + ours * (options.certificate.ca_file is not None)
            )
        if options.acl_file is None:
            file = password_file.beside(options.socket)
            click.echo(f"  it is in {file}; copy that file and name the copy in ${PASSWORD_FILE_VARIABLE}")
        click.echo("  stock scripts give no password: they do not work on this bus")
    elif options.tcp_port is not None:
        whom = "users of the ACL" if options.acl_file is not None else "every user of this machine"
        click.echo(f"stock scripts: redis://localhost:{options.tcp_port}/0, open to {whom}, to no other machine")


def _introduce_bulk(server: KeptServer, options: ServerOptions) -> None:
    from station.bus.address import BULK_VARIABLE

    click.echo(f"bulk bus {server.address} (pid {server.pid}): depth and clouds of what is started from now on")
    if options.bind is not None:
        scheme = "redis" if options.certificate is None else "rediss"
        click.echo(f"  other machines: ${BULK_VARIABLE}={scheme}://{options.bind}:{options.tcp_port}/0, same password")


@command.command("acl")
@click.option("--passwords", metavar="FILE", type=NamedPath(dir_okay=False, path_type=Path), default=None,
              help="Make a password for each role, write them to FILE (mode 0600), print hashes.")  # fmt: skip
@click.option("--password-hash", "hashes", metavar="ROLE=SHA256", multiple=True, help="Hash of a role's password.")
@click.option("--runbook", "books", metavar="RUNBOOK", multiple=True, shell_complete=candidates.runbooks,
              help="A runbook that this bus is for: a role then speaks for its own servers alone.")  # fmt: skip
def acl(passwords: Path | None, hashes: tuple[str, ...], books: tuple[str, ...]) -> None:
    """Print the access control list of a shared bus, with a user per role (Redis 7 or Valkey)."""
    from station.bus import acl as lists
    from station.bus import password_file
    from station.supervision import runbook as runbooks

    found = [runbooks.load(runbooks.find(book)) for book in books]

    digests = dict(_hash(option) for option in hashes)
    if passwords is not None:
        if passwords.exists():
            raise UsageError(
                f"--passwords {passwords}: exists, and may hold passwords in use; name another, or remove it"
            )
        made = {role: password for role, password in lists.new_passwords().items() if role not in digests}
        password_file.write(passwords, made)
        digests |= {role: lists.sha256(password) for role, password in made.items()}
    click.echo(lists.rules(digests, _servers(found) if found else None), nl=False)
    missing = [role for role in lists.ROLES if role not in digests]
    if missing:
        click.echo(f"replace PASSWORD-OF-… of {', '.join(missing)}, or let --passwords make them", err=True)
    click.echo(
        "the server also needs: aclfile FILE, notify-keyspace-events K$gxe, repl-diskless-sync-delay 0, "
        "repl-backlog-size 256mb, proto-max-bulk-len 64mb, maxmemory-policy noeviction",
        err=True,
    )


def _servers(books: list[Runbook]) -> dict[str, set[str]]:
    """Return the names of the servers of some runbooks by role."""
    found: dict[str, set[str]] = {}
    for step in (step for book in books for step in book.servers):
        found.setdefault(step.kind.role, set()).add(step.start)
    return found


def _hash(option: str) -> tuple[str, str]:
    from station.bus import acl as lists
    from station.errors import UnknownName

    role, _, digest = option.partition("=")
    if role not in lists.ROLES:
        raise UnknownName("role", role, lists.ROLES)
    if len(digest) != 64 or set(digest.lower()) - set("0123456789abcdef"):
        raise UsageError(f"--password-hash {role}=…: expected 64 hex digits of a SHA-256")
    return role, digest.lower()


@command.command("info")
@bus_option
@json_option
def info(bus: str | None, as_json: bool) -> None:
    """Show which server a bus is, how it is set up, and who can reach it."""
    from station.bus.client import Bus
    from station.bus.protection import inspect

    with Bus(address_of(bus), name="cli", timeout_s=1.0) as line:
        found = _facts(line)
        protection = inspect(line)
        found["protection"] = f"{protection.verdict}: {protection.found}"
        if line.bulk_address is not None:
            found |= {f"bulk_{name}": value for name, value in _facts(line.open_bulk()).items()}
    if as_json:
        click.echo(json.dumps(found))
        return
    for name, value in found.items():
        click.echo(f"{name:30} {value}")


def _facts(line: Bus) -> dict[str, str]:
    """Return what a server says of itself."""
    text = line.call("INFO").decode()
    fields = dict(row.split(":", 1) for row in text.splitlines() if ":" in row)
    wanted = (
        "valkey_version", "redis_version", "process_id", "uptime_in_seconds", "connected_clients", "connected_slaves",
        "used_memory_human", "maxmemory_policy", "repl_backlog_size", "total_commands_processed",
        "instantaneous_ops_per_sec",
    )  # fmt: skip
    return {"address": str(line.address)} | {name: fields[name] for name in wanted if name in fields}
