"""Our own server: starts anywhere, says why it does not, outlives nobody."""

from __future__ import annotations

import os
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from station.bus import redis_server
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions, find_binary
from station.errors import BusError, ConfigError
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture
def options(tmp_path_factory: pytest.TempPathFactory) -> ServerOptions:
    folder = tmp_path_factory.mktemp("own")
    return ServerOptions(folder=folder, socket=folder / "bus.sock")


@pytest.fixture
def server(options: ServerOptions) -> Iterator[RedisServer]:
    with RedisServer.start(options) as server:
        yield server


def test_server_answers_on_a_socket_that_only_its_user_may_open(server: RedisServer, options: ServerOptions) -> None:
    assert server.address == BusAddress(socket=str(options.socket))
    assert _ask(server.address, "PING") == "PONG"
    assert options.socket is not None
    assert stat.S_IMODE(options.socket.stat().st_mode) == 0o700


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("port", "0"),
        ("protected-mode", "yes"),
        ("save", ""),
        ("appendonly", "no"),
        ("maxmemory-policy", "noeviction"),
        ("repl-backlog-size", str(256 << 20)),
        ("repl-diskless-sync", "yes"),
        ("repl-diskless-sync-delay", "0"),
    ],
)
def test_server_runs_with_the_options_of_the_design(server: RedisServer, option: str, value: str) -> None:
    assert _ask(server.address, "CONFIG", "GET", option)[1].decode() == value


def test_server_notifies_of_sets_deletions_and_expiry(server: RedisServer) -> None:
    flags = _ask(server.address, "CONFIG", "GET", "notify-keyspace-events")[1].decode()
    assert set("K$gx") <= set(flags)


def test_size_of_the_backlog_is_chosen_by_the_caller(options: ServerOptions) -> None:
    with RedisServer.start(ServerOptions(folder=options.folder, socket=options.socket, backlog_mb=3)) as server:
        assert _ask(server.address, "CONFIG", "GET", "repl-backlog-size")[1] == b"%d" % (3 << 20)


def test_stop_ends_the_process_and_removes_the_socket(options: ServerOptions) -> None:
    server = RedisServer.start(options)
    server.stop()
    server.stop()
    assert not _is_alive(server.pid)
    assert options.socket is not None
    assert not options.socket.exists()


def test_stop_ends_a_frozen_server_and_removes_its_socket(
    options: ServerOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(redis_server, "_STOP_TIMEOUT_S", 0.2)
    server = RedisServer.start(options)
    os.kill(server.pid, signal.SIGSTOP)
    server.stop()
    assert not _is_alive(server.pid)
    assert options.socket is not None
    assert not options.socket.exists()


def test_socket_of_a_dead_server_does_not_hinder_a_start(options: ServerOptions) -> None:
    first = RedisServer.start(options)
    os.kill(first.pid, signal.SIGKILL)
    wait_until(lambda: first._process.poll() is not None)
    assert options.socket is not None
    assert options.socket.exists()
    with RedisServer.start(options) as second:
        assert _ask(second.address, "PING") == "PONG"
        first.stop()
        assert _ask(second.address, "PING") == "PONG"  # the first must not take the second's socket away


def test_socket_of_a_living_server_is_left_alone(server: RedisServer, options: ServerOptions) -> None:
    with pytest.raises(BusError, match="already running") as caught:
        RedisServer.start(options)
    assert _is_one_line(caught.value)
    assert _ask(server.address, "PING") == "PONG"


def test_file_in_the_way_of_the_socket_is_not_removed(options: ServerOptions) -> None:
    assert options.socket is not None
    options.socket.write_text("mine")
    with pytest.raises(BusError, match="no socket itself"):
        RedisServer.start(options)
    assert options.socket.read_text() == "mine"


def test_tcp_port_is_opened_on_the_loopback_interface_only(options: ServerOptions) -> None:
    port = _free_port()
    with RedisServer.start(ServerOptions(folder=options.folder, socket=options.socket, tcp_port=port)):
        assert _ask(BusAddress(host="localhost", port=port), "PING") == "PONG"
        assert _listening_addresses(port) <= {"0100007F", "00000000000000000000000001000000"}


def test_server_without_a_socket_is_reached_over_tcp(options: ServerOptions) -> None:
    with RedisServer.start(ServerOptions(folder=options.folder, socket=None, tcp_port=_free_port())) as server:
        assert server.address.socket is None
        assert _ask(server.address, "PING") == "PONG"


def test_busy_port_is_named(options: ServerOptions) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(BusError, match=f"port {port} .* in use") as caught:
            RedisServer.start(ServerOptions(folder=options.folder, socket=options.socket, tcp_port=port))
    assert _is_one_line(caught.value)


def test_another_server_on_the_port_is_not_taken_for_ours(options: ServerOptions) -> None:
    port = _free_port()
    with (
        RedisServer.start(ServerOptions(folder=options.folder, socket=options.socket, tcp_port=port)),
        pytest.raises(BusError, match=f"port {port} .* in use"),
    ):
        RedisServer.start(ServerOptions(folder=options.folder, socket=None, tcp_port=port))


def test_neither_socket_nor_port_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="socket or a TCP port"):
        RedisServer.start(ServerOptions(folder=tmp_path, socket=None))


def test_socket_path_that_no_system_takes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="longer than 104 bytes"):
        RedisServer.start(ServerOptions(folder=tmp_path, socket=tmp_path / ("x" * 120)))


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="must exist"):
        RedisServer.start(ServerOptions(folder=tmp_path / "none", socket=tmp_path / "bus.sock"))


def test_no_binary_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BusError, match="install") as caught:
        find_binary(package="no_such_package")
    assert _is_one_line(caught.value)


def test_binary_of_the_python_package_serves_without_any_on_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, options: ServerOptions
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_binary().name == "valkey-server"
    with RedisServer.start(options) as server:
        assert _ask(server.address, "PING") == "PONG"


def test_binary_on_path_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake = _fake_binary(tmp_path, "exit 0")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_binary() == fake


def test_server_that_dies_at_the_start_is_quoted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, options: ServerOptions
) -> None:
    _fake_binary(tmp_path, "echo 'the disk is on fire'; exit 3")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BusError, match=r"status 3 .*the disk is on fire") as caught:
        RedisServer.start(options)
    assert _is_one_line(caught.value)


def test_binary_that_cannot_run_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, options: ServerOptions
) -> None:
    broken = tmp_path / "redis-server"
    broken.write_bytes(b"\x7fELF")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BusError, match="cannot be started"):
        RedisServer.start(options)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's help is Linux's")
def test_server_dies_when_its_parent_is_killed(options: ServerOptions) -> None:
    script = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from station.bus.redis_server import RedisServer, ServerOptions\n"
        "folder = Path(sys.argv[1])\n"
        "server = RedisServer.start(ServerOptions(folder=folder, socket=folder / 'bus.sock'))\n"
        "print(server.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script, str(options.folder)], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert _is_alive(pid)
        parent.kill()
    wait_until(lambda: not _is_alive(pid))


def _ask(address: BusAddress, *arguments: str) -> Any:
    connection = Connection(address, timeout_s=5.0)
    try:
        answer = connection.call(*arguments)
        return answer.decode() if isinstance(answer, bytes) else answer
    finally:
        connection.close()


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def _listening_addresses(port: int) -> set[str]:
    """Return the local addresses, as the kernel spells them, on which somebody listens on a port."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            address, local_port = line.split()[1].split(":")
            if int(local_port, 16) == port and line.split()[3] == "0A":
                found.add(address)
    return found


def _fake_binary(folder: Path, body: str) -> Path:
    path = folder / "redis-server"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


def _is_alive(pid: int) -> bool:
    """Whether a process runs; one that is dead and waits for its parent's question does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def _is_one_line(error: BaseException) -> bool:
    return "\n" not in str(error)


def test_where_it_is_permitted_the_server_runs_in_real_time(tmp_path: Path) -> None:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        pytest.skip("real-time scheduling is not permitted here")
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with RedisServer.start(ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")) as server:
        assert os.sched_getscheduler(server.pid) == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
