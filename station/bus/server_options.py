"""Where our own server listens, which clients it lets in, and how that is told to it."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

from station.bus.address import BusAddress, bulk_beside
from station.errors import BusError, ConfigError

_SOCKET_PATH_LIMIT = 104  # bytes; the smallest limit among the systems that we run on

_LAST_PORT = 65535

LARGEST_VALUE = 64 << 20
"""Bytes of the largest value that a server of ours takes: a raw picture of 20 million points."""


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What a server shows who it is with, and whom it lets in by theirs.

    Attributes:
        file, key_file: Its certificate and the key of that, as PEM.
        ca_file: Authority that has to have signed the certificate of each client; None lets in clients without one.
    """

    file: Path
    key_file: Path
    ca_file: Path | None = None


@dataclass(frozen=True, kw_only=True)
class ServerOptions:
    """Where our server listens.

    Attributes:
        socket: Path of its unix socket, opened to this user only; None for TCP only.
        tcp_port: Port on the loopback interface; None opens no TCP port at all.
        bind: Address that the port is opened on beside the loopback interface, for other machines; needs a password
            or an ACL.
        certificate: What the port is wrapped in TLS with, for all who use it; None leaves it in clear text.
        password: What everybody must say first, on the socket too; it goes to the server through a pipe, and to this
            user's other processes through a file of mode 0600 beside the socket. None asks for none.
        acl_file: File of users and what each may do, in place of a password.
        login: User and password of ours in that file.
        max_value_mb: Largest value that the server takes [MiB]; it hangs up on a client that sends a larger one, so no
            reader of the bus ever has to hold one.
        folder: Existing folder for its log and for snapshots on their way to a replica.
        backlog_mb: How much of the write stream a tap that was cut off can still catch up with [MiB]; three JPEG
            cameras fill 256 MiB in about 45 s. Memory is used only as the stream grows.
        is_urgent: Whether it is to run before all else that may wait, where this user may ask for that.
    """

    socket: Path | None
    tcp_port: int | None = None
    folder: Path
    bind: str | None = None
    certificate: Certificate | None = None
    password: str | None = field(default=None, repr=False)
    acl_file: Path | None = None
    login: tuple[str, str] | None = field(default=None, repr=False)
    max_value_mb: int = LARGEST_VALUE >> 20
    backlog_mb: int = 256
    is_urgent: bool = True

    def __post_init__(self) -> None:
        """Refuse what would open the bus to everybody.

        Raises:
            ConfigError: an address without a password, an ACL or a port, or a certificate without an address.
        """
        if self.bind is None:
            if self.certificate is not None:
                raise ConfigError("a certificate is for a bus of several machines: name an address of this one, --bind")
            return
        if self.password is None and self.acl_file is None:
            raise ConfigError(f"bus on {self.bind}: only with a password or an ACL; anybody there could move the robot")
        if self.tcp_port is None:
            raise ConfigError(f"bus on {self.bind}: needs a TCP port")
        if self.bind.startswith("-") or not self.bind.isprintable() or " " in self.bind:
            raise ConfigError(f"bus on {self.bind!r}: expected an address of this machine, or * for all of them")

    @property
    def own_login(self) -> tuple[str | None, str | None]:
        """User and password that our own processes give."""
        return self.login or (None, self.password)


def bulk_options(options: ServerOptions) -> ServerOptions:
    """Return how the bulk bus of a bus with a socket is started: for the same users, and on the next port for others.

    It must not take a processor from the bus that a robot obeys, and 30 MB/s fill its backlog in 17 s.

    Raises:
        ConfigError: the bus has no socket, or no port is next.
    """
    if options.socket is None:
        raise ConfigError("a bulk bus stands beside a bus with a socket")
    port = None if options.bind is None or options.tcp_port is None else options.tcp_port + 1
    if port is not None and port > _LAST_PORT:
        raise ConfigError(f"the bulk bus takes the port behind that of the bus, and none is behind {options.tcp_port}")
    return replace(options, socket=bulk_beside(options.socket), tcp_port=port, backlog_mb=512, is_urgent=False)


def address_of(options: ServerOptions) -> BusAddress:
    """Return the address under which our own processes reach the server.

    Raises:
        BusError: the path of the socket is too long.
        ConfigError: neither a socket nor a port was asked for.
    """
    user, password = options.own_login
    if options.socket is not None:
        if len(os.fsencode(options.socket)) > _SOCKET_PATH_LIMIT:
            raise BusError(f"socket {options.socket}: longer than {_SOCKET_PATH_LIMIT} bytes; choose a shorter path")
        return BusAddress(socket=str(options.socket), username=user, password=password)
    if options.tcp_port is not None:
        return BusAddress(host="127.0.0.1", port=options.tcp_port, username=user, password=password)
    raise ConfigError("a bus server needs a socket or a TCP port; neither was given")


def arguments(options: ServerOptions) -> list[str]:
    """Return the settings that everybody may see."""
    listen = [*_port(options), "--protected-mode", "yes"]
    if options.tcp_port is not None:
        listen += ["--bind", *_interfaces(options.bind)]
    if options.socket is not None:
        listen += ["--unixsocket", str(options.socket), "--unixsocketperm", "700"]
    return [
        *listen,
        *("--dir", str(options.folder)),
        *("--save", ""),
        *("--appendonly", "no"),
        *("--maxmemory-policy", "noeviction"),
        # K: keyspace channels; $: strings; g: del, rename; x: expired; e: evicted (a foreign maxmemory setting)
        *("--notify-keyspace-events", "K$gxe"),
        *("--proto-max-bulk-len", f"{options.max_value_mb}mb"),
        *("--repl-diskless-sync", "yes"),
        *("--repl-diskless-sync-delay", "0"),  # the default makes each tap wait 5 s before it is armed
        *("--repl-backlog-size", f"{options.backlog_mb}mb"),
        *("--repl-backlog-ttl", "0"),  # keep it however long the recorder is away
        *("--repl-ping-replica-period", "1"),  # a tap tells a dead link from a quiet bus within seconds
        *("--client-output-buffer-limit", "replica", "1gb", "0", "0"),  # a stalled disk must not cost the tap its link
    ]


def _port(options: ServerOptions) -> list[str]:
    port, certificate = str(options.tcp_port or 0), options.certificate
    if certificate is None:
        return ["--port", port]
    authority = certificate.ca_file
    clients = ["no"] if authority is None else ["yes", "--tls-ca-cert-file", str(authority.absolute())]
    return ["--port", "0", "--tls-port", port, "--tls-cert-file", str(certificate.file.absolute()),
            "--tls-key-file", str(certificate.key_file.absolute()), "--tls-auth-clients", *clients]  # fmt: skip


def _interfaces(bind: str | None) -> list[str]:
    """Return the addresses to listen on; all of them hold the loopback ones, which must not be bound twice."""
    loopback = ["127.0.0.1", "-::1"]  # "-": a machine without IPv6 is fine
    every = {"*": ["*", "-::*"], "0.0.0.0": ["0.0.0.0", "-::1"], "::": ["127.0.0.1", "::"]}
    if bind is None or bind in ("127.0.0.1", "::1"):
        return loopback
    return every.get(bind, [*loopback, bind])


def secret_settings(options: ServerOptions) -> str:
    """Return the settings that must not show in the process list."""
    lines = []
    if options.password is not None:
        lines.append(f"requirepass {options.password}")
    if options.acl_file is not None:
        lines.append(f'aclfile "{options.acl_file.absolute()}"')
        lines.append("shutdown-timeout 0")  # as our own user cannot set it later; every server with such lists has it
    return "".join(line + "\n" for line in lines)
