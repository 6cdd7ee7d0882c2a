"""The console server: a running station in a browser. ``station console`` starts one and prints its links."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from station import libraries
from station.bus.address import is_loopback
from station.config import to_plain
from station.episode.storage.folder import data_folder
from station.life.server import Life, ServerKind


class ConsoleConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the console.

    Attributes:
        host: Address to serve pages on; on any other than a loopback one they are served with TLS.
        port: Port to serve pages on; 0 takes a free one.
        names: Further names that a browser may open the page as.
        certificate, key: Files of a certificate of your own and its key, as PEM; None for one that the console makes.
        data: Folder of episodes; None: ``$STATION_DATA``, else ``./data``.
        check: Whether episodes that are recorded while it runs are checked, behind everything else.
        rate_hz: How often it looks at the bus [Hz]; robots are drawn as often.
        niceness: How far the process stands back behind others, 0 to 19; more delays the stop on a busy machine.
    """

    host: str = "127.0.0.1"
    port: int = 8770
    names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    data: Path | None = None
    check: bool = True
    rate_hz: float = 30.0
    niceness: int = 0

    def __post_init__(self) -> None:
        if not self.host.strip():
            raise ValueError("host is empty; expected an address of this machine, for example 127.0.0.1")
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}; expected 0 to 65535")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key belong together; name both, or neither")
        if not 1.0 <= self.rate_hz <= 120.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 1 to 120")
        if not 0 <= self.niceness <= 19:
            raise ValueError(f"niceness is {self.niceness}; expected 0 to 19")


def main(config: ConsoleConfig, life: Life) -> int:
    """Serve pages until asked to stop; return the exit code."""
    from station.web.console import Console

    os.nice(config.niceness)
    with Console(
        life.bus.address, data_folder(config.data), host=config.host, port=config.port, names=config.names,
        certificate=None if config.certificate is None or config.key is None else (config.certificate, config.key),
        is_open=not is_loopback(config.host), name=life.name, is_judging=config.check,
    ) as console:  # fmt: skip
        life.configured({"server": life.name, "role": KIND.role, "url": console.url, "config": to_plain(config)})
        if life.ready():
            console.run(life.stop_event, config.rate_hz, life.report)
    return 0


KIND = ServerKind(
    name="console",
    role="console",
    summary="shows a running station in a browser, with a stop",
    config=ConsoleConfig,
    main=main,
    expect=lambda config: libraries.expect("the console", "starlette", "console"),
    bus_timeout_s=0.25,
)
