"""Where a page is, and the links that let a browser in."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence

from station.bus.address import is_loopback
from station.web.config import PageConfig
from station.web.keyring import ROLES, Keyring, Role

EVERY = ("0.0.0.0", "::", "*")
"""Addresses that stand for all of this machine."""


def names_of(host: str, more: Sequence[str] = ()) -> list[str]:
    """Return what a page on an address may be opened as: that, this machine's names, and the loopback ones."""
    machine = socket.gethostname()
    usual = [machine, f"{machine}.local", "localhost", "127.0.0.1", "::1"]
    every = _addresses() if host in EVERY else [host]
    return list(dict.fromkeys([*every, *usual, *more]))


def _addresses() -> list[str]:
    """Return the addresses of this machine for others, as far as its name, or its way out, says."""
    found: list[str] = []
    with contextlib.suppress(OSError):  # a machine whose name nothing resolves
        found += [str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # sends nothing: the kernel chooses the card that leads out
        found.append(str(probe.getsockname()[0]))
    return [name for name in dict.fromkeys(found) if "%" not in name and not is_loopback(name)]


def url(config: PageConfig, port: int) -> str:
    """Return where a page is that is served on a port; of an address that stands for all of them, on one of them."""
    host = names_of(config.host)[0] if config.host in EVERY else config.host
    return f"http{'s' * config.is_secure}://{f'[{host}]' if ':' in host else host}:{port}/"


def link(page: str, keyring: Keyring, role: Role) -> str:
    """Return what lets a browser in to a page as a role."""
    return f"{page}?token={keyring.token(role)}"


def of(config: PageConfig) -> dict[Role, str]:
    """Return the links of a console that is configured so, by role; none where it takes any port."""
    if not config.port:
        return {}
    page, keyring = url(config, config.port), Keyring()
    return {role: link(page, keyring, role) for role in reversed(ROLES)}
