"""The stop line of a station: whoever says stop is heard, whatever else is said, and learns who was told."""

from __future__ import annotations

import os
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgspec
import pytest

from station.bus import address as addresses
from station.bus.address import BusAddress
from station.life import stop_line
from station.life.stop_file import StopFile
from station.life.stop_line import StopCall, StopLine, StopReply
from tests.waiting import wait_until

BUS = BusAddress(socket="/nowhere/bus.sock")
G1 = StopReply(told=("g1",))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The runtime folder, of a path that is too long for these sockets: they have one all the same."""
    (tmp_path / "run").mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return addresses.runtime_folder("stop-12345678-4194304.sock")


@contextmanager
def station(
    reply: StopReply = G1, address: BusAddress = BUS, act: Callable[[], object] = lambda: None
) -> Iterator[list[str]]:
    """Listen as a station does; what it was asked for is in the list."""
    heard: list[str] = []

    def stop(reason: str) -> StopReply:
        heard.append(reason)
        act()
        return reply

    with StopLine(address, stop) as line:
        assert line.failure == ""
        yield heard


def said(reason: str = "ada, it smokes", address: BusAddress = BUS) -> StopReply:
    return StopCall(address, reason).reply()


def sockets(folder: Path) -> list[Path]:
    return list(folder.glob("stop-*.sock"))


def test_who_says_stop_learns_who_was_told_and_it_is_kept(folder: Path) -> None:
    with station(StopReply(told=("g1", "kassow"), not_told=("far",))) as heard:
        (path,) = sockets(folder)
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert said() == StopReply(told=("g1", "kassow"), not_told=("far",))
        assert heard == ["ada, it smokes"]
    assert sockets(folder) == []
    latched = StopFile(BUS).read()
    assert latched is not None
    assert latched.reason == "ada, it smokes"


def test_who_waits_for_no_answer_is_heard_all_the_same() -> None:
    with station() as heard:
        StopCall(BUS, "ada").close()
        wait_until(lambda: heard == ["ada"])


def test_where_no_station_is_nobody_is_told() -> None:
    assert said() == StopReply()


def test_a_socket_that_a_killed_station_left_is_passed_over_and_cleared_by_the_next(folder: Path) -> None:
    prefix = stop_line._prefix(BUS)
    stale = folder / f"{prefix}4194304.sock"  # more than any process has
    ours = folder / f"{prefix}{os.getpid()}.sock"  # of an earlier process of the same number
    for path in (stale, ours):
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(path))
    (folder / f"{prefix}junk.sock").write_text("no socket")
    assert said() == StopReply()
    with station():
        assert sockets(folder) == [ours]
        assert said() == G1


def test_each_bus_has_its_own_line_by_whatever_user_and_name_it_is_reached() -> None:
    local = BusAddress(host="localhost", port=7001)
    with station(address=local) as one, station(address=msgspec.structs.replace(local, db=1)) as other:
        assert said("a", msgspec.structs.replace(local, host="127.0.0.1", username="viewer", password="x")) == G1
        assert (one, other) == (["a"], [])
        said("b", msgspec.structs.replace(local, db=1))
        assert (one, other) == (["a"], ["b"])
        assert said("c", msgspec.structs.replace(local, port=7002)) == StopReply()


def test_a_station_that_is_frozen_holds_up_no_other_and_nobody_for_long(folder: Path) -> None:
    goes_on = threading.Event()
    with ExitStack() as stack:
        stack.enter_context(station(act=goes_on.wait))
        stack.callback(goes_on.set)
        (frozen,) = sockets(folder)
        frozen.rename(frozen.with_name(frozen.name.replace(str(os.getpid()), "1")))
        stack.enter_context(station(StopReply(told=("kassow",))))
        assert said() == StopReply(told=("kassow",))
        assert not goes_on.is_set()


@pytest.mark.parametrize("line", [b"", b"stopp", b"STOP now", b"go", b"\xff\x00", b"[" * 900])
def test_what_is_no_stop_stops_nothing_and_is_told_so(folder: Path, line: bytes) -> None:
    with station() as heard:
        with socket.socket(socket.AF_UNIX) as caller:
            caller.connect(str(sockets(folder)[0]))
            caller.sendall(line + b"\n")
            reply = stop_line.decode_reply(caller.recv(4096))
        assert reply is not None
        assert reply.why_not.startswith("expected `stop <reason>`, got ")
        assert (reply.told, heard) == ((), [])


def test_a_reason_steers_no_terminal_and_is_one_line(folder: Path) -> None:
    with station() as heard:
        said("a\nb\x1b[2J" + "c" * 5000)
        (reason,) = heard
        assert reason.startswith("a\\x0ab\\x1b[2Jc")
        assert len(reason) < 300
        with socket.socket(socket.AF_UNIX) as caller:
            caller.connect(str(sockets(folder)[0]))
            caller.sendall(b"stop")
            caller.shutdown(socket.SHUT_WR)
            assert stop_line.decode_reply(caller.recv(4096)) == G1
        assert heard[1:] == ["stop line"]


def test_a_flood_of_garbage_and_of_callers_who_say_nothing_holds_up_no_stop(folder: Path) -> None:
    with station() as heard, ExitStack() as stack:
        path, is_over = str(sockets(folder)[0]), threading.Event()

        def flood() -> None:
            idle: list[socket.socket] = []
            while not is_over.is_set():
                caller = socket.socket(socket.AF_UNIX)
                caller.setblocking(False)
                try:
                    caller.connect(path)
                    caller.send(b"x" * 5000 if len(idle) % 2 else b"st")
                except OSError:
                    caller.close()
                    time.sleep(0.001)
                else:
                    idle.append(caller)
                if len(idle) > 100:
                    idle.pop(0).close()
            for each in idle:
                each.close()

        threads = [threading.Thread(target=flood) for _ in range(3)]
        for thread in threads:
            thread.start()
        stack.callback(lambda: [thread.join() for thread in threads])
        stack.callback(is_over.set)
        for number in range(20):
            StopCall(BUS, f"press {number}").reply()
        wait_until(lambda: len(heard) == 20)
    assert heard == [f"press {number}" for number in range(20)]


def test_a_folder_that_others_can_open_is_told_and_refuses_nothing_else(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "o" / "station").mkdir(parents=True, mode=0o755)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "o"))
    monkeypatch.setattr(addresses, "_SOCKET_PATH_LIMIT", 1000)
    with StopLine(BUS, lambda _: G1) as line:
        assert line.failure.startswith("no process can stop these robots past the bus: ")
        assert "mode 0700" in line.failure
        assert said() == StopReply()
