"""A bus with a user per role, and whoever wants to be one of them."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from station.bus import acl
from station.bus.address import BusAddress
from station.bus.redis_server import RedisServer, ServerOptions

As = Callable[[str], BusAddress]


@pytest.fixture
def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


@pytest.fixture
def passwords() -> dict[str, str]:
    return acl.new_passwords()


@pytest.fixture
def shared_bus(
    tmp_path_factory: pytest.TempPathFactory, passwords: dict[str, str], free_port: int
) -> Iterator[RedisServer]:
    """A real server that reads the list that `station bus acl` prints."""
    folder = tmp_path_factory.mktemp("shared")
    file = folder / "users.acl"
    file.write_text(acl.rules({role: acl.sha256(password) for role, password in passwords.items()}))
    options = ServerOptions(
        folder=folder, socket=folder / "bus.sock", tcp_port=free_port, acl_file=file,
        login=("operator", passwords["operator"]),
    )  # fmt: skip
    with RedisServer.start(options) as server:
        yield server


@pytest.fixture
def as_role(shared_bus: RedisServer, passwords: dict[str, str]) -> As:
    """Return the bus's address with the user of a role."""

    def address(role: str) -> BusAddress:
        return msgspec.structs.replace(shared_bus.address, username=role, password=passwords[role])

    return address


@pytest.fixture
def password_file(tmp_path: Path, passwords: dict[str, str]) -> Path:
    from station.bus import password_file as files

    file = tmp_path / "passwords"
    files.write(file, passwords)
    return file
