"""Where a console's page is, and the links that let a browser in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from station.bus.address import is_loopback
from station.web.keyring import ROLES, Keyring, Role

EVERY = ("0.0.0.0", "::", "*")
"""Addresses that stand for all of this machine."""


def url(host: str, port: int, *, is_secure: bool) -> str:
    """Return where a page is that is served on an address and a port."""
    return f"http{'s' * is_secure}://{f'[{host}]' if ':' in host else host}:{port}/"


def link(page: str, keyring: Keyring, role: Role) -> str:
    """Return what lets a browser in to a page as a role."""
    return f"{page}?token={keyring.token(role)}"


def of_config(config: Mapping[str, Any]) -> dict[str, str]:
    """Return the links of a console that is configured so, by role; none where it takes any port.

    Args:
        config: Its settings, in plain values.
    """
    host, port = str(config["host"]), int(config["port"])
    if not port:
        return {}
    is_secure = not is_loopback(host) or config["certificate"] is not None
    page, keyring = url(host, port, is_secure=is_secure), Keyring()
    return {role: link(page, keyring, role) for role in reversed(ROLES)}
