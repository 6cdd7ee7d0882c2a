"""A process's line to the bus, on a real server."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

import pytest

from station.bus import client, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Write, open_tap
from station.errors import BusError
from tests.bus.answering import answering
from tests.faults.bus_station import pid_of
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")


def test_a_write_sets_the_key_and_its_stamp_together(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
        before_ns = time.monotonic_ns()
        assert bus.publish({"k": b"v", "other": b"w"})
        sample = bus.read(["k"])["k"]
    assert sample.value == b"v"
    assert sample.stamp is not None
    assert sample.stamp.seq == 1
    assert sample.stamp.source == bus.source
    assert sample.stamp.writer == "motion"
    assert sample.stamp.is_from_this_boot
    assert before_ns <= sample.stamp.mono_ns <= time.monotonic_ns()


def test_sequence_numbers_count_the_writes_of_each_key(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
        for _ in range(3):
            bus.publish({"a": b"1"})
        bus.publish({"a": b"1", "b": b"1"})
        read = bus.read(["a", "b"])
    assert [(key, sample.stamp.seq) for key, sample in read.items() if sample.stamp] == [("a", 4), ("b", 1)]


def test_a_devices_capture_time_travels_with_the_stamp(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="pico", timeout_s=5.0) as bus:
        bus.publish({"k": b"v"}, capture_ns=123)
        mark = bus.read(["k"])["k"].stamp
    assert mark is not None
    assert mark.capture_ns == 123


def test_a_batch_is_as_many_writes_each_with_its_own_stamp(bus_server: BusAddress) -> None:
    tap = open_tap(bus_server)
    with contextlib.closing(tap), Bus(bus_server, name="imu", timeout_s=5.0) as bus:
        assert bus.publish_in_turn([])
        assert bus.publish_in_turn([({"k": b"%d" % number}, 100 + number) for number in range(20)])
        assert not bus.is_late
        assert bus.publish({"k": b"last"})
        came: list[Write] = []

        def has_all() -> bool:
            came.extend(write for write in tap.read(0.05) if write.key == "k")
            return len(came) == 21

        wait_until(has_all)
    marks = [stamp.decode(write.stamp or b"") for write in came]
    assert [write.value for write in came] == [*(b"%d" % number for number in range(20)), b"last"]
    assert [mark and (mark.seq, mark.capture_ns) for mark in marks[:20]] == [(n + 1, n + 100) for n in range(20)]


def test_names_lists_keys_without_their_stamps(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
        bus.publish({f"k{n}": b"v" for n in range(50)})
        assert bus.names("k*") == sorted(f"k{n}" for n in range(50))


def test_a_lost_bus_is_told_at_once_counted_and_found_again(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    server = RedisServer.start(options)
    with Bus(server.address, name="motion", timeout_s=5.0) as bus:
        bus.publish({"k": b"1"})
        os.kill(server.pid, signal.SIGKILL)
        server.stop()
        assert not bus.publish({"k": b"2"})
        assert not bus.publish({"k": b"3"})
        assert bus.lost_writes == 2
        assert not bus.is_connected
        with pytest.raises(BusError):
            bus.get("k")
        with RedisServer.start(options):
            wait_until(lambda: bus.is_connected)
            assert bus.publish({"k": b"4"})
            mark = bus.read(["k"])["k"].stamp
    assert mark is not None
    assert mark.seq == 4, "the lost writes must show as a hole"


def freeze(bus: Bus) -> int:
    pid = pid_of(bus.address)
    os.kill(pid, signal.SIGSTOP)
    return pid


def test_a_frozen_server_holds_a_writer_no_longer_than_its_time_out(
    bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "_STALL_S", DEADLINE_S)
    with Bus(bus_server, name="motion") as bus:
        pid = freeze(bus)
        try:
            assert all(bus.publish({"k": b"1"}) for _ in range(100)), "kept, to be sent when the server goes on"
            monkeypatch.setattr(client, "_STALL_S", 0.5)
            wait_until(lambda: not bus.publish({"k": b"1"}))
            assert not bus.is_connected
            assert bus.lost_writes > 100
        finally:
            monkeypatch.setattr(client, "_STALL_S", DEADLINE_S)
            os.kill(pid, signal.SIGCONT)
        wait_until(lambda: bus.is_connected)
        assert bus.publish({"k": b"2"})


@pytest.mark.parametrize("size", [10, 100_000], ids=["that the line holds", "that must wait outside it"])
def test_a_server_that_stalls_for_a_moment_loses_no_write(bus_server: BusAddress, size: int) -> None:
    with Bus(bus_server, name="motion", timeout_s=0.01) as bus, Bus(bus_server, name="other", timeout_s=5.0) as other:
        pid = freeze(bus)
        for n in range(30):
            assert bus.publish({f"k{n}": b"x" * size})
        os.kill(pid, signal.SIGCONT)
        wait_until(lambda: bus.publish({"last": b"x"}) and not bus.is_late)
        samples = other.read([f"k{n}" for n in range(30)])
        assert [sample.value for sample in samples.values()] == [b"x" * size] * 30
        assert bus.lost_writes == 0


def test_a_writer_that_fell_behind_catches_up_by_writing_alone(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=0.01) as bus:
        pid = freeze(bus)
        for _ in range(5):
            bus.publish({"k": b"x"})
        assert bus.is_late
        os.kill(pid, signal.SIGCONT)
        wait_until(lambda: bus.publish({"k": b"x"}) and not bus.is_late)
        for _ in range(200):
            assert bus.publish({"k": b"x"})
        assert bus.lost_writes == 0


def test_a_writer_that_will_not_queue_learns_without_writing_that_the_server_has_answered(
    bus_server: BusAddress,
) -> None:
    with Bus(bus_server, name="test") as bus:
        pid = freeze(bus)
        bus.publish({"k": b"1"})
        assert not bus.catch_up()
        os.kill(pid, signal.SIGCONT)
        wait_until(bus.catch_up)
        assert not bus.is_late
        assert bus.lost_writes == 0
        bus.set_timeout(5.0)
        assert bus.get("k") == b"1"


def test_a_long_silence_of_the_writer_is_not_held_against_the_server(
    bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "_STALL_S", 1.0)
    with Bus(bus_server, name="motion", timeout_s=0.01) as bus:
        bus.publish({"k": b"1"})
        silent_since = time.monotonic()
        wait_until(lambda: time.monotonic() - silent_since > 1.1)
        pid = freeze(bus)
        try:
            assert bus.publish({"k": b"2"})
            assert bus.is_connected
        finally:
            monkeypatch.setattr(client, "_STALL_S", DEADLINE_S)
            os.kill(pid, signal.SIGCONT)
        wait_until(lambda: bus.publish({"k": b"3"}) and not bus.is_late)
        assert bus.lost_writes == 0


def test_a_server_that_takes_nothing_any_more_is_given_up_before_memory_is(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="camera", timeout_s=0.01) as bus:
        pid = freeze(bus)
        try:
            wait_until(lambda: not bus.publish({"k": b"x" * 1_000_000}))
            assert not bus.is_connected
        finally:
            os.kill(pid, signal.SIGCONT)


def test_an_unreachable_bus_names_the_address_and_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(BusError, match=r"nowhere\.sock.*station up"):
        Bus(BusAddress(socket=str(tmp_path / "nowhere.sock")), name="motion")


def test_a_refused_write_counts_as_lost_and_says_why(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
        bus.call("CONFIG", "SET", "maxmemory", "1")
        assert not bus.publish({"k": b"v" * 1000})
        assert "OOM" in bus.last_error
        assert bus.lost_writes == 1


def test_stamps_survive_the_wire_and_foreign_text_is_none() -> None:
    mark = stamp.Stamp(7, 11, 13, stamp.new_source("a.b c"), 17)
    assert stamp.decode(mark.encode()) == mark
    assert mark.writer == "a-b-c"
    for text in (b"", b"1 2 3", b"1 2 x y", b"a b c d", b"1 2 3 \xff", b"1 2 3 s 4 5"):
        assert stamp.decode(text) is None


def test_what_answers_there_is_no_redis(tmp_path: Path) -> None:
    with (
        answering(tmp_path / "web.sock", {b"SELECT": b"HTTP/1.1 400 Bad Request\r\n\r\n"}) as address,
        pytest.raises(BusError, match="no Redis server"),
    ):
        Bus(address, name="test")
