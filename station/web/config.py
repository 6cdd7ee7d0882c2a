"""How pages are served, and how a console is set up."""

from __future__ import annotations

from pathlib import Path

import msgspec

from station.bus.address import is_loopback


class PageConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where pages are served.

    Attributes:
        host: Address to serve pages on; on any other than a loopback one they are served with TLS.
        port: Port to serve pages on; 0 takes a free one.
        names: Further names that a browser may open the page as.
        certificate, key: Files of a certificate of your own and its key, as PEM; None for one that is made here.
    """

    host: str = "127.0.0.1"
    port: int = 0
    names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        if not self.host.strip():
            raise ValueError("host is empty; expected an address of this machine, for example 127.0.0.1")
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}; expected 0 to 65535")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key belong together; name both, or neither")

    @property
    def is_open(self) -> bool:
        """Whether pages are served to other machines."""
        return not is_loopback(self.host)

    @property
    def is_secure(self) -> bool:
        """Whether pages are served with TLS."""
        return self.is_open or self.certificate is not None


class ConsoleConfig(PageConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the console, beside where its pages are.

    Attributes:
        data: Folder of episodes; None: ``$STATION_DATA``, else ``./data``.
        check: Whether episodes that are recorded while it runs are checked, behind everything else.
        rate_hz: How often it looks at the bus [Hz]; robots are drawn as often.
        niceness: How far the process stands back behind others, 0 to 19; more delays the stop on a busy machine.
    """

    port: int = 8770
    data: Path | None = None
    check: bool = True
    rate_hz: float = 30.0
    niceness: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        super().__post_init__()
        if not 1.0 <= self.rate_hz <= 120.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 1 to 120")
        if not 0 <= self.niceness <= 19:
            raise ValueError(f"niceness is {self.niceness}; expected 0 to 19")
