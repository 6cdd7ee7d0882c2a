"""Where the bus is: one URL, and what may be said of it in a log."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path
from urllib.parse import parse_qs, quote, unquote, urlsplit

import msgspec

from station.errors import ConfigError

ENVIRONMENT_VARIABLE = "STATION_BUS"
PASSWORD_VARIABLE = "STATION_BUS_PASSWORD"
CA_VARIABLE = "STATION_BUS_CA"
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
    """

    host: str = "localhost"
    port: int = 6379
    socket: str | None = None
    db: int = 0
    username: str | None = None
    password: str | None = None
    tls: bool = False
    ca_file: str | None = None

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

    def __str__(self) -> str:
        """Return the address without credentials."""
        if self.socket is not None:
            return f"unix://{self.socket}" + (f"?db={self.db}" if self.db else "")
        return f"{'rediss' if self.tls else 'redis'}://{self.host}:{self.port}/{self.db}"

    __repr__ = __str__


def parse(text: str) -> BusAddress:
    """Read ``redis://``, ``rediss://`` (TLS) or ``unix://`` with optional credentials and database.

    ``$STATION_BUS_PASSWORD`` gives a password that the URL does not; ``$STATION_BUS_CA`` names a file of certificates.

    Raises:
        ConfigError: not such a URL.
    """
    parts = urlsplit(text)
    password = unquote(parts.password) if parts.password else os.environ.get(PASSWORD_VARIABLE)
    username = unquote(parts.username) if parts.username else None
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
            )
        raise ValueError(f"scheme {parts.scheme!r}")
    except ValueError:
        shown = f"{parts.scheme}://{parts.hostname or ''}…" if parts.scheme else repr(text[:20])
        raise ConfigError(
            f"bus address {shown}: expected redis://HOST:PORT/DB, rediss://HOST:PORT/DB or unix:///PATH?db=N"
        ) from None


def runtime_folder() -> Path:
    """Return the folder (mode 0700) that holds this user's sockets; made when missing."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    short = Path(tempfile.gettempdir()) / f"station-{os.getuid()}"
    folder = Path(base) / "station" if base else short
    if len(os.fsencode(folder / "bus.sock")) > _SOCKET_PATH_LIMIT:
        # A socket's path must be short; folders that differ must not meet in one.
        folder = short.with_name(f"{short.name}-{hashlib.sha256(os.fsencode(folder)).hexdigest()[:8]}")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    owner = folder.stat()
    if owner.st_uid != os.getuid() or owner.st_mode & 0o077:
        raise ConfigError(f"{folder}: must belong to you and be closed to others (mode 0700); remove or mend it")
    return folder


def own() -> BusAddress:
    """Return the address of this user's own server: a socket that only they can open."""
    return BusAddress(socket=str(runtime_folder() / "bus.sock"))


def default() -> BusAddress:
    """Return the bus to use when none is named: ``$STATION_BUS``, else this user's own."""
    url = os.environ.get(ENVIRONMENT_VARIABLE)
    return parse(url) if url else own()
