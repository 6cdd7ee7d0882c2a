"""Where the bus is: one URL, and what may be said of it in a log."""

from __future__ import annotations

import hashlib
import ipaddress
import os
import socket as sockets
import tempfile
from pathlib import Path
from urllib.parse import SplitResult, parse_qs, quote, unquote, urlsplit

import msgspec

from station.bus import password_file, stream
from station.clock import SYSTEM, Clock
from station.errors import ConfigError
from station.user_config import user_config

ENVIRONMENT_VARIABLE = "STATION_BUS"
BULK_VARIABLE = "STATION_BULK"
NO_BULK = "none"
"""What the variable says where depth and clouds go over the bus itself, whatever else there is."""
USER_VARIABLE = "STATION_BUS_USER"
PASSWORD_VARIABLE = "STATION_BUS_PASSWORD"
PASSWORD_FILE_VARIABLE = "STATION_BUS_PASSWORD_FILE"
CA_VARIABLE = "STATION_BUS_CA"
CERTIFICATE_VARIABLE = "STATION_BUS_CERT"
KEY_VARIABLE = "STATION_BUS_KEY"
DEFAULT_USER = "operator"  # of a file that has passwords for several users: the command line's
_EXPECTED = "expected redis://HOST:PORT/DB, rediss://HOST:PORT/DB or unix:///PATH?db=N"
_SOCKET_PATH_LIMIT = 104  # bytes; the smallest limit among the systems that we run on


class BusAddress(msgspec.Struct, frozen=True, kw_only=True):
    """A Redis or Valkey server.

    Attributes:
        host, port: TCP address; unused when `socket` is set.
        socket: Path of a unix socket, or None.
        db: Number of the database; stock TWIST uses 0.
        username, password: Credentials, or None.
        tls: Whether TCP is wrapped in TLS.
        ca_file: File with the certificates to trust for TLS; None trusts the system's.
        certificate_file, key_file: Our own certificate and its key, for a server that asks for one.
    """

    host: str = "localhost"
    port: int = 6379
    socket: str | None = None
    db: int = 0
    username: str | None = None
    password: str | None = None
    tls: bool = False
    ca_file: str | None = None
    certificate_file: str | None = None
    key_file: str | None = None

    @property
    def url(self) -> str:
        """The address as a URL, credentials included: for child processes and libraries, never for a log."""
        login = ""
        if self.password is not None:
            login = f"{quote(self.username or '', safe='')}:{quote(self.password, safe='')}@"
        if self.socket is not None:
            return f"unix://{login}{quote(self.socket)}?db={self.db}"
        scheme = "rediss" if self.tls else "redis"
        return f"{scheme}://{login}{self.host}:{self.port}/{self.db}"

    @property
    def is_local(self) -> bool:
        """Whether the server is on this machine, as far as the address says: a tunnel looks like one that is."""
        return self.socket is not None or is_loopback(self.host)

    @property
    def clock(self) -> Clock:
        """Time where the server is reached: the machine's. Whoever talks to the server takes it from here."""
        return SYSTEM

    def open(self, timeout_s: float) -> sockets.socket:
        """Connect within a time [s].

        Raises:
            OSError: it cannot be reached.
            ConfigError: the files of TLS cannot be used.
        """
        if self.socket is not None:
            return stream.open_unix(self.socket, timeout_s)
        plain = stream.open_tcp(self.host, self.port, timeout_s)
        if not self.tls:
            return plain
        try:
            context = stream.tls_context(self.ca_file, self.certificate_file, self.key_file)
        except OSError as error:
            plain.close()
            files = [file for file in (self.ca_file, self.certificate_file, self.key_file) if file]
            raise ConfigError(f"bus {self}: TLS files {', '.join(files)}: {error.strerror or error}") from None
        try:
            return context.wrap_socket(plain, server_hostname=self.host)
        except OSError:
            plain.close()
            raise

    def __str__(self) -> str:
        """Return the address without credentials."""
        if self.socket is not None:
            return f"unix://{self.socket}" + (f"?db={self.db}" if self.db else "")
        return f"{'rediss' if self.tls else 'redis'}://{self.host}:{self.port}/{self.db}"

    __repr__ = __str__


def is_loopback(host: str) -> bool:
    """Whether an address, or the name localhost, is reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def parse(text: str) -> BusAddress:
    """Read ``redis://``, ``rediss://`` (TLS) or ``unix://`` with optional credentials and database.

    What the URL does not say comes from the environment: ``$STATION_BUS_USER``, ``$STATION_BUS_PASSWORD`` or
    ``$STATION_BUS_PASSWORD_FILE``; for TLS ``$STATION_BUS_CA``, ``$STATION_BUS_CERT`` and ``$STATION_BUS_KEY``.

    Raises:
        ConfigError: not such a URL, or a file of passwords that cannot be used.
    """
    try:
        parts = urlsplit(text)
    except ValueError:
        raise ConfigError(f"bus address: not a URL; {_EXPECTED}") from None
    username, password = _login(parts)
    try:
        if parts.scheme == "unix":
            db = int(parse_qs(parts.query).get("db", ["0"])[0])
            path = unquote(parts.path)
            if not path:
                raise ValueError("no path")
            return BusAddress(socket=path, db=db, username=username, password=password)
        if parts.scheme in ("redis", "rediss"):
            return BusAddress(
                host=parts.hostname or "localhost",
                port=parts.port or 6379,
                db=int(parts.path.strip("/") or 0),
                username=username,
                password=password,
                tls=parts.scheme == "rediss",
                ca_file=os.environ.get(CA_VARIABLE),
                certificate_file=os.environ.get(CERTIFICATE_VARIABLE),
                key_file=os.environ.get(KEY_VARIABLE),
            )
        raise ValueError(f"scheme {parts.scheme!r}")
    except ValueError:
        shown = f"{parts.scheme}://{parts.hostname or ''}…" if parts.scheme else repr(text[:20])
        raise ConfigError(f"bus address {shown}: {_EXPECTED}") from None


def login_of_environment() -> tuple[str | None, str | None]:
    """Return user and password of the environment, or of the file that it names; None for what it does not say.

    Raises:
        ConfigError: the file cannot be used, or has no such user.
    """
    return _login(urlsplit(""))


def _login(parts: SplitResult) -> tuple[str | None, str | None]:
    """Return user and password: of the URL, else of the environment, else of the file that it names."""
    user = unquote(parts.username) if parts.username else os.environ.get(USER_VARIABLE) or None
    password = unquote(parts.password) if parts.password else os.environ.get(PASSWORD_VARIABLE) or None
    file = os.environ.get(PASSWORD_FILE_VARIABLE)
    if password is not None or not file:
        return user, password
    return _login_of(Path(file), user)


def _login_of(file: Path, user: str | None) -> tuple[str | None, str]:
    """Return the user, or the one that is meant where none is named, with the password that a file has for them."""

    passwords = password_file.read(file)
    for name in [user] if user else [DEFAULT_USER, "", *sorted(passwords)[:1]]:
        if name in passwords:
            return name or None, passwords[name]
    raise ConfigError(f"password file {file}: has no password of user {user or DEFAULT_USER!r}")


def runtime_folder(longest: str = "bus.sock") -> Path:
    """Return the folder (mode 0700) that holds this user's sockets; made when missing.

    Args:
        longest: The longest name of a socket that it is for.
    """
    base = os.environ.get("XDG_RUNTIME_DIR")
    short = Path(tempfile.gettempdir()) / f"station-{os.getuid()}"
    folder = Path(base) / "station" if base else short
    if len(os.fsencode(folder / longest)) > _SOCKET_PATH_LIMIT:
        # A socket's path must be short; folders that differ must not meet in one.
        folder = short.with_name(f"{short.name}-{hashlib.sha256(os.fsencode(folder)).hexdigest()[:8]}")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    owner = folder.stat()
    if owner.st_uid != os.getuid() or owner.st_mode & 0o077:
        raise ConfigError(f"{folder}: must belong to you and be closed to others (mode 0700); remove or mend it")
    return folder


def own() -> BusAddress:
    """Return the address of this user's own server: a socket that only they can open.

    One that is open to the network too asks everybody for a password, and has left it in a file beside the socket: that
    of the user who began it, unless ``$STATION_BUS_USER`` names another.

    Raises:
        ConfigError: no password of that user is known.
    """
    socket = runtime_folder() / "bus.sock"
    file = password_file.beside(socket)
    if not file.exists():
        return BusAddress(socket=str(socket))
    user, password = login_of_environment() if os.environ.get(USER_VARIABLE) else (None, None)
    if password is None:
        user, password = _login_of(file, user)
    return BusAddress(socket=str(socket), username=user, password=password)


def default() -> BusAddress:
    """Return the bus to use when none is named: ``$STATION_BUS``, else the user's default, else this user's own."""
    url = os.environ.get(ENVIRONMENT_VARIABLE) or user_config().bus
    return parse(url) if url else own()


def bulk_beside(socket: str | Path) -> Path:
    """Return where the socket of the bulk bus is that belongs to a bus with a socket."""
    return Path(socket).with_name("bulk.sock")


def bulk_of(bus: BusAddress) -> BusAddress | None:
    """Return the bulk bus of a bus; None where depth and clouds go over that itself.

    Of the default bus it is ``$STATION_BULK``, else ``bulk`` of the user's file; else, of any bus, the socket that a
    server of ours has beside that of the bus. User and password are those of the bus. A file that cannot be read is in
    the way of the default bus alone: an emergency stop on another one does not wait until it is mended.

    Raises:
        ConfigError: what names it is no address.
    """
    try:
        url = os.environ.get(BULK_VARIABLE) or user_config().bulk
        is_default = bool(url) and str(bus) == str(default())
    except ConfigError:
        url, is_default = None, False
    if url and is_default:
        found = None if url == NO_BULK else parse(url)
    elif bus.socket is not None and (socket := bulk_beside(bus.socket)).exists():
        found = msgspec.structs.replace(bus, socket=str(socket))
    else:
        return None
    if found is None or str(found) == str(bus):
        return None
    if bus.password is None:
        return found
    return msgspec.structs.replace(found, username=bus.username, password=bus.password)
