"""A stop that was latched is kept until somebody releases it."""

from __future__ import annotations

import fcntl
import json
import os
import stat
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.bus import keys
from station.bus.address import BusAddress, own
from station.bus.client import Bus
from station.life import stop_file
from station.life.stop_file import NotKept, StopFile, StopKeeper

BUS = BusAddress(socket="/nowhere/bus.sock")


def test_it_says_since_when_by_what_and_how_to_release() -> None:
    assert StopFile(BUS).read() is None
    StopFile(BUS).latch("anna, smoke")
    latched = StopFile(BUS).read()
    assert latched is not None
    assert latched.since_wall_ns is not None
    day = time.strftime("%Y-%m-%d", time.localtime(latched.since_wall_ns * 1e-9))
    assert str(latched).startswith(f"the emergency stop is latched since {day} ")
    assert str(latched).endswith(
        " (anna, smoke); release it with `station estop --reset --bus unix:///nowhere/bus.sock`"
    )
    StopFile(BUS).latch("ben, again")
    assert StopFile(BUS).read() == latched, "it is latched since the first"
    StopFile(BUS).release("anna")
    assert StopFile(BUS).read() is None


def test_the_own_bus_needs_no_name_to_be_released() -> None:
    StopFile(own()).latch("anna")
    assert str(StopFile(own()).read()).endswith("release it with `station estop --reset`")


def test_two_buses_and_two_databases_have_stops_of_their_own() -> None:
    others = [BusAddress(socket="/nowhere/bus.sock", db=1), BusAddress(), BusAddress(port=6380)]
    StopFile(BUS).latch("anna")
    assert [StopFile(other).read() for other in others] == [None] * 3
    login = BusAddress(socket="/nowhere/bus.sock", username="operator", password="secret")
    assert StopFile(login).read() is not None, "it is the same bus, whatever the role is called"
    assert "secret" not in StopFile(login).path.read_text()


def test_it_is_a_private_file_of_the_state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    StopFile(BUS).latch("anna")
    path = StopFile(BUS).path
    assert path.parent == tmp_path / "state" / "station" / "stops"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert StopFile(BUS).path.parent == tmp_path / ".local" / "state" / "station" / "stops"


@pytest.mark.parametrize("data", [b"", b"{", b"null", b"\xff", b'{"stop": false}', b'{"stop": 1e999}', b"[" * 9999])
def test_a_file_that_cannot_be_read_counts_as_a_stop_and_can_be_released(data: bytes) -> None:
    file = StopFile(BUS)
    file.latch("anna")
    file.path.write_bytes(data)
    latched = file.read()
    assert latched is not None
    assert str(file.path) in str(latched)
    assert "what cannot be read counts as a stop; release it with" in str(latched).replace(")", "")
    file.release("anna")
    assert file.read() is None


def test_a_folder_that_cannot_be_used_is_told_and_counts_as_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "state").write_text("no folder")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert "Not a directory; what cannot be read counts as a stop" in str(StopFile(BUS).read())
    for act in (StopFile(BUS).latch, StopFile(BUS).release):
        with pytest.raises(NotKept, match=r"json: (Not a directory|File exists); make it writable, or remove it"):
            act("anna")
    keeper = StopKeeper(BUS)
    keeper.latch("anna")
    keeper.close()
    assert "make it writable" in keeper.failure


WORDS = st.lists(st.tuples(st.booleans(), st.integers(1, 50)), min_size=1, unique_by=lambda word: word[1])


@settings(max_examples=25)  # each word waits for the disk
@given(WORDS)
def test_whatever_is_written_late_the_newest_word_counts(words: list[tuple[bool, int]]) -> None:
    file = StopFile(BUS)
    file.path.unlink(missing_ok=True)
    for is_stop, asked_ns in words:
        (file.latch if is_stop else file.release)("anna", asked_ns)
    newest_is_stop, _ = max(words, key=lambda word: word[1])
    assert (file.read() is not None) == newest_is_stop


def test_a_word_from_before_a_reboot_is_older_than_any_of_now() -> None:
    file = StopFile(BUS)
    file.latch("anna", asked_ns=2**62)
    word = json.loads(file.path.read_bytes())
    file.path.write_text(json.dumps(word | {"boot": "another"}))
    assert file.read() is not None, "a stop outlives a reboot"
    file.release("anna", asked_ns=1)
    assert file.read() is None


def test_of_many_who_write_at_once_the_newest_word_counts() -> None:
    def write(number: int) -> None:
        for turn in range(10):
            asked_ns = 1 + number + 6 * turn
            (StopFile(BUS).latch if asked_ns % 2 else StopFile(BUS).release)("anna", asked_ns)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    word = json.loads(StopFile(BUS).path.read_bytes())
    assert (word["stop"], word["asked_ns"]) == (False, 60)


def test_a_file_that_is_locked_by_a_frozen_process_holds_up_nobody() -> None:
    file = StopFile(BUS)
    file.latch("anna")
    descriptor = os.open(file.path.with_suffix(".lock"), os.O_RDWR)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        file.release("anna")
    finally:
        os.close(descriptor)
    assert file.read() is None


def test_a_release_is_not_lost_to_a_stop_that_a_slow_disk_writes_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes longer than anybody waits for the lock: a latch of before must not undo a release of after."""
    sync, is_slow, is_syncing = os.fsync, threading.Event(), threading.Event()

    def slow_sync(descriptor: int) -> None:
        if threading.current_thread() is latching and not is_slow.is_set():
            is_syncing.set()
            is_slow.wait(30.0)
        sync(descriptor)

    latching = threading.Thread(target=StopFile(BUS).latch, args=("anna", 1))
    monkeypatch.setattr(os, "fsync", slow_sync)
    latching.start()
    assert is_syncing.wait(30.0)
    StopFile(BUS).release("anna", 2)
    is_slow.set()
    latching.join()
    assert StopFile(BUS).read() is None


def test_the_bus_tells_of_a_stop_that_no_file_has(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="t", timeout_s=5.0) as bus:
        assert stop_file.latched(bus) is None
        bus.call("SET", keys.ESTOP, b"1")
        assert str(stop_file.latched(bus)).startswith("the emergency stop is latched (emergency stop); release it with")
        bus.call("SET", keys.stamp(keys.ESTOP), b"1 1 " + b"9" * 400 + b" anna.1.b.n")
        assert "latched (emergency stop)" in str(stop_file.latched(bus)), "any number may stand in a stamp"
        bus.publish({keys.ESTOP: b'{"stop": true, "who": "anna"}'})
        assert "latched since " in str(stop_file.latched(bus))
        bus.publish({keys.ESTOP: b"0"})
        assert stop_file.latched(bus) is None
