"""A bus for other machines: only with a password, which stands nowhere that others could read."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from station.bus import address as addresses
from station.bus import keys, password_file
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.protection import inspect
from station.bus.redis_server import RedisServer, ServerOptions
from station.errors import BusError, ConfigError, NotReady
from station.supervision.checks import BusCheck
from station.supervision.doctor import bus_access
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

SECRET = "a-password-that-nobody-guesses"


@pytest.fixture
def protected(tmp_path_factory: pytest.TempPathFactory, free_port: int) -> Iterator[RedisServer]:
    folder = tmp_path_factory.mktemp("open")
    options = ServerOptions(
        folder=folder, socket=folder / "bus.sock", tcp_port=free_port, bind="0.0.0.0", password=SECRET
    )
    with RedisServer.start(options) as server:
        yield server


@pytest.fixture
def unprotected(tmp_path: Path, free_port: int) -> Iterator[BusAddress]:
    """What the published set-up does: open to the network, without a password."""
    from station.bus.redis_server import find_binary

    arguments = ["--port", str(free_port), "--bind", "0.0.0.0", "--protected-mode", "no", "--save", ""]
    with subprocess.Popen([str(find_binary()), *arguments], stdout=subprocess.DEVNULL, cwd=tmp_path) as process:
        address = BusAddress(host="127.0.0.1", port=free_port)
        wait_until(lambda: _answers(address))
        yield address
        process.kill()


def _answers(address: BusAddress) -> bool:
    try:
        Connection(address, timeout_s=1.0).close()
    except BusError:
        return False
    return True


def test_an_address_of_the_network_is_refused_without_a_password(tmp_path: Path) -> None:
    for address in ("0.0.0.0", "*", "192.168.1.5", "::"):
        with pytest.raises(ConfigError, match="only with a password or an ACL"):
            ServerOptions(folder=tmp_path, socket=tmp_path / "s", tcp_port=1, bind=address)


@pytest.mark.parametrize("bind", ["-x", "a b", "1.2.3.4 --protected-mode no", "a\nb"])
def test_an_address_cannot_carry_other_settings(tmp_path: Path, bind: str) -> None:
    with pytest.raises(ConfigError, match="expected an address"):
        ServerOptions(folder=tmp_path, socket=tmp_path / "s", tcp_port=1, bind=bind, password=SECRET)


def test_a_protected_bus_lets_in_who_knows_the_password(protected: RedisServer, free_port: int) -> None:
    with Bus(protected.address, name="own", timeout_s=5.0) as bus:
        bus.publish({"a": b"1"})
    Connection(BusAddress(host="127.0.0.1", port=free_port, password=SECRET), timeout_s=5.0).close()
    for address in (
        BusAddress(host="127.0.0.1", port=free_port),
        BusAddress(socket=protected.address.socket),
        BusAddress(host="127.0.0.1", port=free_port, password="guess"),
    ):
        with pytest.raises(BusError, match="password"):
            Connection(address, timeout_s=5.0)


def test_the_password_is_in_a_file_of_its_own_and_nowhere_else(protected: RedisServer) -> None:
    socket = Path(str(protected.address.socket))
    file = password_file.beside(socket)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    for path in socket.parent.iterdir():
        if path.is_file() and path != file:
            assert SECRET not in path.read_text(errors="replace"), path
    process = Path("/proc") / str(protected.pid)
    assert SECRET.encode() not in (process / "cmdline").read_bytes()
    assert SECRET.encode() not in (process / "environ").read_bytes()
    assert SECRET not in f"{protected.address} {protected.address!r} {protected!r}"
    protected.stop()
    assert not file.exists()


def test_options_do_not_show_their_secrets(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=None, tcp_port=1, password=SECRET, login=("a", SECRET))
    assert SECRET not in repr(options)


def test_a_later_server_without_a_password_is_found_although_a_killed_one_left_a_file() -> None:
    folder = addresses.runtime_folder()
    first = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock", password=SECRET))
    assert addresses.own().password == SECRET
    os.kill(first.pid, signal.SIGKILL)
    first._process.wait()
    with RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock")):
        assert addresses.own().password is None
        Connection(addresses.own(), timeout_s=5.0).close()
    first.stop()


def test_a_user_that_the_environment_names_is_meant_on_a_bus_of_our_own_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside = password_file.beside(addresses.runtime_folder() / "bus.sock")
    password_file.write(beside, {"operator": "o"})
    password_file.write(tmp_path / "all", {"operator": "o", "viewer": "v"})
    monkeypatch.setenv("STATION_BUS_PASSWORD_FILE", str(tmp_path / "all"))
    assert (addresses.own().username, addresses.own().password) == ("operator", "o")
    monkeypatch.setenv("STATION_BUS_USER", "viewer")
    assert (addresses.own().username, addresses.own().password) == ("viewer", "v")
    monkeypatch.delenv("STATION_BUS_PASSWORD_FILE")
    with pytest.raises(ConfigError, match="no password of user 'viewer'"):
        addresses.own()
    beside.unlink()
    assert addresses.own().username is None


def test_who_reads_a_password_file_while_it_is_written_finds_a_whole_one(tmp_path: Path) -> None:
    file = tmp_path / "passwords"
    password_file.write(file, {"operator": SECRET})
    ended = threading.Event()

    def write() -> None:
        while not ended.is_set():
            password_file.write(file, {"operator": SECRET})

    writer = threading.Thread(target=write)
    writer.start()
    try:
        assert all(password_file.read(file) == {"operator": SECRET} for _ in range(1000))
    finally:
        ended.set()
        writer.join()


def test_start_of_an_open_bus_tells_where_the_password_is_and_what_does_not_work(free_port: int) -> None:
    arguments = [sys.executable, "-m", "station", "bus", "start", "--bind", "0.0.0.0", "--tcp", str(free_port)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(5)]
        file = password_file.beside(addresses.runtime_folder() / "bus.sock")
        password = file.read_text().strip()
        assert len(password) >= 32
        with Bus(None, name="own", timeout_s=5.0) as bus:  # found by itself, password and all
            assert inspect(bus).verdict == "closed"
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    said = "".join(lines)
    assert password not in said
    assert str(file) in said
    assert "stock scripts give no password" in said
    assert not file.exists()


def test_start_with_a_loopback_port_says_that_every_user_of_the_machine_may_use_it(free_port: int) -> None:
    arguments = [sys.executable, "-m", "station", "bus", "start", "--tcp", str(free_port)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(3)]
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    assert "open to every user of this machine" in lines[1]


def test_an_unprotected_bus_fails_the_check_and_is_broken_to_the_doctor(
    unprotected: BusAddress, tmp_path: Path
) -> None:
    with Bus(unprotected, name="check", timeout_s=5.0) as bus:
        with pytest.raises(NotReady, match="without a password") as failed:
            BusCheck().run(bus, tmp_path, threading.Event())
        assert "\n" not in str(failed.value)
        assert "open to the network" in BusCheck(allow_open=True).run(bus, tmp_path, threading.Event())
        assert bus_access(bus).level == "broken"
        assert bus.names() == []  # looking has written nothing
        bus.call("CONFIG", "SET", "protected-mode", "yes")
        assert inspect(bus).verdict == "closed"


def test_a_server_warns_of_an_open_bus_and_a_command_of_a_password_among_its_arguments(unprotected: BusAddress) -> None:
    arguments = [sys.executable, "-m", "station", "serve", "recorder", "--bus", unprotected.url]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert "open to the network" in process.stderr.readline()
        process.kill()
    done = subprocess.run(
        [sys.executable, "-m", "station", "status", "--bus", unprotected.url.replace("//", "//:word@")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "a password in --bus shows in the process list" in done.stderr
    assert "word@" not in done.stdout + done.stderr


def test_a_bus_of_our_own_passes_the_check(bus_server: BusAddress, protected: RedisServer, tmp_path: Path) -> None:
    for address in (bus_server, protected.address):
        with Bus(address, name="check", timeout_s=5.0) as bus:
            BusCheck().run(bus, tmp_path, threading.Event())
            assert bus_access(bus).level == "ok"


def test_a_bus_whose_settings_may_not_be_read_is_unknown_unless_it_asks_for_a_password(
    unprotected: BusAddress,
) -> None:
    with Bus(unprotected, name="check", timeout_s=5.0) as bus:
        bus.call("ACL", "SETUSER", "default", "-config")
        assert inspect(bus).verdict == "unknown"
        assert bus_access(bus).level == "warning"


def test_an_agent_joins_no_bus_that_lets_everybody_in(unprotected: BusAddress) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "station", "host", "join", "--name", "a", "--bus", unprotected.url],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "and so could start servers here; start it with `station bus start`" in done.stderr


def test_acl_command_prints_hashes_and_leaves_the_passwords_in_a_closed_file(tmp_path: Path) -> None:
    file = tmp_path / "passwords"
    done = _acl("--passwords", str(file))
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    passwords = [line.split()[1] for line in file.read_text().splitlines()]
    assert len(passwords) == 8
    assert not [word for word in passwords if word in done.stdout + done.stderr]
    assert done.stdout.startswith("user default reset off\n")
    assert "exists, and may hold passwords in use" in _acl("--passwords", str(file), code=2).stderr
    assert [line.split()[1] for line in file.read_text().splitlines()] == passwords
    assert "PASSWORD-OF-command" in _acl().stdout
    digest = "ab" * 32
    assert f"user viewer reset on #{digest}" in _acl("--password-hash", f"viewer={digest}").stdout
    assert _acl("--password-hash", "viewer=x", code=2).stderr.startswith("station: --password-hash viewer")
    assert "did you mean 'viewer'" in _acl("--password-hash", f"viewr={digest}", code=2).stderr


def test_a_list_for_a_runbook_lets_a_role_speak_for_its_own_servers_alone() -> None:
    users = {line.split()[1]: line.split() for line in _acl("--runbook", "g1-demo").stdout.splitlines()}
    own = {role: [right for right in rights if keys.SERVER_PREFIX in right] for role, rights in users.items()}
    assert own["low-level"] == [f"%W~{keys.server('g1')}", f"%W~{keys.server('g1')}@"]
    assert own["command"] == [f"%W~{keys.server('motion')}", f"%W~{keys.server('motion')}@"]
    assert own["viewer"] == own["operator"] == own["observer"] == []
    assert f"%W~{keys.server_config('g1')}@" in users["low-level"]
    assert "did you mean 'g1-demo'" in _acl("--runbook", "g1-dmo", code=2).stderr


def _acl(*arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", "station", "bus", "acl", *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stderr
    return done


def test_credentials_come_from_the_environment_or_from_a_closed_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from station.life.serving import for_role

    file = tmp_path / "passwords"
    password_file.write(file, {"operator": "o", "viewer": "v", "recorder": "r"})
    monkeypatch.setenv("STATION_BUS_PASSWORD_FILE", str(file))
    found = addresses.parse("redis://lab:6379/0")
    assert (found.username, found.password) == ("operator", "o")
    assert for_role(found, "recorder").url == "redis://recorder:r@lab:6379/0"
    assert for_role(found, "command") == found  # it has none: as it is
    monkeypatch.setenv("STATION_BUS_USER", "viewer")
    assert for_role(found, "recorder") == found  # who is named is meant
    assert addresses.parse("redis://lab:6379/0").password == "v"
    monkeypatch.setenv("STATION_BUS_USER", "root")
    with pytest.raises(ConfigError, match="no password of user 'root'"):
        addresses.parse("redis://lab:6379/0")
    file.chmod(0o640)
    with pytest.raises(ConfigError, match="others can read it"):
        addresses.parse("redis://lab:6379/0")
    monkeypatch.setenv("STATION_BUS_PASSWORD", "given")
    assert addresses.parse("redis://lab:6379/0").password == "given"


def test_a_value_beyond_the_limit_never_enters_our_bus(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("small")
    with RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock", max_value_mb=1)) as server:
        connection = Connection(server.address, timeout_s=5.0)
        connection.call("SET", "fits", b"x" * (1 << 20))
        with pytest.raises(BusError):
            connection.call("SET", "a", b"x" * ((1 << 20) + 1))
        connection.close()
        connection = Connection(server.address, timeout_s=5.0)
        with pytest.raises(BusError):
            connection.call("SETRANGE", "fits", 1 << 20, b"more")
        connection.close()
        with Bus(server.address, name="check", timeout_s=5.0) as bus:
            assert bus.names() == ["fits"]
