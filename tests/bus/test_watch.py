"""The newest value at hand, and how old it is, on a real server."""

from __future__ import annotations

import math
import os
import signal
import threading
import time
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest
import redis

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.outage import Outages
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.watch import Watch
from tests.bus.answering import answering
from tests.bus.proxy import Proxy
from tests.faults.bus_station import frozen, pause, pid_of
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")


def test_a_value_that_was_there_before_has_no_age(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
        bus.publish({"k": b"old"})
        with bus.watch(["k"]) as watch:
            sample = watch.latest("k")
            assert sample is not None
            assert sample.value == b"old"
            assert sample.age_s(time.monotonic_ns()) == math.inf
            assert watch.latest("k", max_age_s=1e9) is None


def test_a_new_value_arrives_with_its_stamp_and_age(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"new"})
        sample = watch.wait("k", after=None, timeout_s=DEADLINE_S)
        assert sample is not None
        assert sample.value == b"new"
        assert sample.stamp is not None
        assert sample.arrived_ns is not None
        assert sample.arrived_ns >= sample.stamp.mono_ns
        assert sample.age_s(time.monotonic_ns()) < DEADLINE_S
        assert watch.wait("k", after=sample, timeout_s=0.05) is None


def test_who_asks_for_it_is_told_of_each_change_by_the_watch_itself(bus_server: BusAddress) -> None:
    told: list[tuple[str, list[str], bytes | None]] = []
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
        bus.publish({"k": b"old"})

        def tell(changed: Collection[str]) -> None:
            sample = found[0].latest("k") if found else None
            told.append((threading.current_thread().name, sorted(changed), sample.value if sample else None))

        found: list[Watch] = []
        with bus.watch(["k", "another"], on_change=tell) as watch:
            wait_until(lambda: told)  # that it has begun to hear
            assert told[0][1] == ["another", "k"]
            found.append(watch)
            bus.publish({"k": b"new"})
            wait_until(lambda: ("bus-watch", ["k"], b"new") in told)
            bus.call("DEL", "k")
            wait_until(lambda: told[-1] == ("bus-watch", ["k"], None))


def test_any_of_several_keys_wakes_who_has_not_seen_its_value(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus, bus.watch(["a", "b"]) as watch:
        bus.publish({"a": b"1"})
        reads = watch.wait_any(0, DEADLINE_S)
        assert watch.latest("a") is not None
        woken = threading.Event()

        def wait() -> None:
            if watch.wait_any(reads, DEADLINE_S) > reads:
                woken.set()

        threading.Thread(target=wait, daemon=True).start()
        assert not woken.wait(0.1), "what was seen wakes nobody"
        bus.publish({"b": b"2"})
        assert woken.wait(DEADLINE_S)


def test_the_newest_of_many_writes_ends_in_the_slot(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus, bus.watch(["k"]) as watch:
        for n in range(2000):
            bus.publish({"k": b"%d" % n})
        wait_until(lambda: (sample := watch.latest("k")) is not None and sample.value == b"1999")


def test_a_foreign_writer_is_seen_even_over_a_native_stamp(bus_server: BusAddress) -> None:
    foreign = redis.Redis(unix_socket_path=bus_server.socket or "")
    with foreign, Bus(bus_server, name="motion", timeout_s=5.0) as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"native"})
        native = watch.wait("k", after=None, timeout_s=DEADLINE_S)
        foreign.set("k", b"foreign")
        sample = watch.wait("k", after=native, timeout_s=DEADLINE_S)
        assert sample is not None
        assert (sample.value, sample.stamp) == (b"foreign", None)
        foreign.set("k", b"foreign")
        again = watch.wait("k", after=sample, timeout_s=DEADLINE_S)
        assert again is not None, "the same bytes written again are a fresh command"
        bus.publish({"k": b"native"})
        back = watch.wait("k", after=again, timeout_s=DEADLINE_S)
        assert back is not None
        assert back.stamp is not None


def test_a_deleted_key_leaves_its_slot(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"v"})
        wait_until(lambda: watch.latest("k") is not None)
        bus.call("DEL", "k")
        wait_until(lambda: watch.latest("k") is None)


def test_a_watch_outlives_a_killed_server_and_keeps_telling_the_age(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    server = RedisServer.start(options)
    with Bus(server.address, name="motion") as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"1"})
        first = watch.wait("k", after=None, timeout_s=DEADLINE_S)
        assert first is not None
        os.kill(server.pid, signal.SIGKILL)
        server.stop()
        wait_until(lambda: not watch.is_connected)
        assert watch.latest("k") is first
        with RedisServer.start(options):
            wait_until(lambda: watch.is_connected and bus.publish({"k": b"2"}))
            second = watch.wait("k", after=first, timeout_s=DEADLINE_S)
            assert second is not None
            assert second.value == b"2"


def test_after_a_cut_it_reads_again_what_changed_meanwhile_and_calls_none_of_it_fresh(bus_server: BusAddress) -> None:
    wanted = ["changed", "overwritten", "same", "gone"]
    with (
        Proxy(bus_server) as network,
        Bus(bus_server, name="motion", timeout_s=5.0) as bus,
        Watch(network.address, wanted) as watch,
    ):
        bus.publish({key: b"before" for key in wanted})
        wait_until(lambda: all(watch.latest(key) for key in wanted))
        before = {key: watch.latest(key) for key in wanted}
        network.cut()
        wait_until(lambda: not watch.is_connected)
        known = watch.connections
        bus.publish({"changed": b"meanwhile"})
        bus.call("SET", "overwritten", b"by a stock script")
        bus.call("DEL", "gone")
        network.mend()
        wait_until(lambda: watch.connections > known)
        after = {key: watch.latest(key) for key in wanted}
        assert after["same"] is before["same"]
        assert after["gone"] is before["gone"]
        for key, value in (("changed", b"meanwhile"), ("overwritten", b"by a stock script")):
            sample = after[key]
            assert sample is not None
            assert (sample.value, sample.age_s(time.monotonic_ns())) == (value, math.inf)
            assert watch.latest(key, max_age_s=1e9) is None
        assert watch.wait("changed", after=None, timeout_s=0.05) is None
        bus.publish({"changed": b"after"})
        fresh = watch.wait("changed", after=after["changed"], timeout_s=DEADLINE_S)
        assert fresh is not None
        assert (fresh.value, fresh.age_s(time.monotonic_ns()) < DEADLINE_S) == (b"after", True)


def test_a_frozen_server_is_noticed(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus, bus.watch(["k"]) as watch:
        pid = int(bus.call("INFO", "server").split(b"process_id:")[1].split()[0])
        os.kill(pid, signal.SIGSTOP)
        try:
            wait_until(lambda: not watch.is_connected)
        finally:
            os.kill(pid, signal.SIGCONT)
        wait_until(lambda: watch.is_connected)


def test_a_server_that_refuses_notifications_is_polled(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="admin", timeout_s=5.0) as admin:
        admin.call("ACL", "SETUSER", "plain", "on", ">pw", "~*", "&*", "+@all", "-config")
        address = BusAddress(socket=bus_server.socket, username="plain", password="pw")
        admin.call("CONFIG", "SET", "notify-keyspace-events", "")
        with Bus(address, name="motion", timeout_s=5.0) as bus, Watch(address, ["k"]) as watch:
            for n in range(5):
                bus.publish({"k": b"%d" % n})
                wait_until(lambda n=n: (s := watch.latest("k")) is not None and s.value == b"%d" % n)
            sample = watch.latest("k")
            assert sample is not None


PROBE_S, FROZEN_S = 0.05, 0.6  # shorter than what is given up


@pytest.fixture
def probed(bus_server: BusAddress) -> Iterator[Watch]:
    with Watch(bus_server, ["k"], probe_s=PROBE_S) as watch:
        yield watch


def wait_until_heard(watch: Watch, seconds: float) -> None:
    """Wait until it has heard for so long without a break."""
    wait_until(lambda: watch.heard.until_ns - watch.heard.since_ns > seconds * 1e9)


def when_it_stands(pid: int) -> int:
    """Wait until a process that was stopped answers nobody any more; return the instant [ns]."""
    wait_until(lambda: Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].startswith("T"))
    return time.monotonic_ns()


def expect_nothing_new(watch: Watch, pid: int) -> int:
    """Expect that of a server that was stopped nothing is known from then on; return since when [ns]."""
    frozen_ns = when_it_stands(pid)
    pause(FROZEN_S)
    assert watch.heard.until_ns <= frozen_ns
    return frozen_ns


def cuts(outages: Outages) -> list[str]:
    """Return why a watch was cut that was not just answered late, as on a busy machine."""
    return [str(one.numbers["reason"]) for one in outages._held if "in time" not in one.numbers["reason"]]


def test_of_an_idle_bus_it_is_known_that_nothing_was_written(bus_server: BusAddress) -> None:
    outages = Outages()
    with Watch(bus_server, ["k"], probe_s=PROBE_S, outages=outages) as watch:
        wait_until_heard(watch, 0.5)
        assert watch.heard.until_ns < time.monotonic_ns()
        assert cuts(outages) == []


def test_of_a_frozen_bus_nothing_is_known_and_when_it_is_back_it_begins_anew(
    bus_server: BusAddress, probed: Watch
) -> None:
    wait_until_heard(probed, 0.2)
    pid = pid_of(bus_server)
    with frozen(pid):
        expect_nothing_new(probed, pid)
        thawed_ns = time.monotonic_ns()
    wait_until(lambda: probed.heard.until_ns > thawed_ns)
    assert probed.heard.since_ns >= thawed_ns
    wait_until_heard(probed, 0.3)


@pytest.mark.parametrize("cut_s", [0.0, FROZEN_S])
def test_of_a_cut_line_nothing_is_known_and_when_it_is_back_it_begins_anew(
    bus_server: BusAddress, cut_s: float
) -> None:
    with Proxy(bus_server) as network, Watch(network.address, ["k"], probe_s=PROBE_S) as watch:
        wait_until_heard(watch, 0.1)
        network.cut()
        cut_ns = time.monotonic_ns()
        pause(cut_s)
        assert watch.heard.until_ns <= cut_ns
        network.mend()
        wait_until(lambda: watch.heard.until_ns > cut_ns)
        assert watch.heard.since_ns > cut_ns
        wait_until_heard(watch, 0.1)


def test_what_was_written_before_it_knows_of_every_write_is_at_hand(bus_server: BusAddress, probed: Watch) -> None:
    written: list[int] = [time.monotonic_ns()]  # when the n-th write was done
    ended = threading.Event()

    def write() -> None:
        with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
            while not ended.is_set():
                bus.publish({"k": b"%d" % len(written)})
                written.append(time.monotonic_ns())

    writer = threading.Thread(target=write)
    writer.start()
    try:
        wait_until(lambda: probed.latest("k") is not None)
        proofs: set[int] = set()
        while len(proofs) < 25:
            (since_ns, known_ns), sample = probed.heard, probed.latest("k")
            if since_ns == known_ns:  # it has just begun to hear, and knows of no time yet
                continue
            proofs.add(known_ns)
            assert sample is not None
            newest = int(sample.value)
            assert newest + 1 >= len(written) or written[newest + 1] > known_ns, "a later one was written before that"
    finally:
        ended.set()
        writer.join()


def test_an_answer_proves_nothing_before_what_was_told_ahead_of_it_is_taken_up(tmp_path: Path) -> None:
    answers = {b"SUBSCRIBE": b":1\r\n:1\r\n", b"MGET": b"*2\r\n$-1\r\n$-1\r\n"}
    answers[b"CONFIG"] = b"*2\r\n$1\r\nx\r\n$4\r\nK$gx\r\n"
    pong = b"*2\r\n$4\r\npong\r\n$0\r\n\r\n"
    with answering(tmp_path / "bus.sock", answers) as address:
        answers[b"PING"] = pong
        with Watch(address, ["k"], probe_s=PROBE_S) as watch:
            wait_until_heard(watch, 0.1)
            answers[b"MGET"] = b""  # it is told of a write with the next answer, and cannot read it
            answers[b"PING"] = b"*3\r\n$7\r\nmessage\r\n$16\r\n__keyspace@0__:k\r\n$3\r\nset\r\n" + pong
            told_ns = time.monotonic_ns()
            wait_until(lambda: not watch.is_connected)
            assert watch.heard.until_ns <= told_ns


def test_a_half_open_line_of_messages_is_given_up_though_the_server_answers_on_the_other(
    bus_server: BusAddress,
) -> None:
    with (
        Proxy(bus_server) as network,
        Watch(network.address, ["k"]) as watch,
        Bus(bus_server, name="motion", timeout_s=5.0) as bus,
    ):
        known = watch.connections
        network.swallow(only_newest=True)
        wait_until(lambda: watch.connections > known)
        bus.publish({"k": b"1"})
        wait_until(lambda: watch.latest("k") is not None)


def test_a_bus_that_is_polled_is_known_as_of_the_last_look(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="admin", timeout_s=5.0) as admin:
        admin.call("ACL", "SETUSER", "plain", "on", ">pw", "~*", "&*", "+@all", "-config")
        address = BusAddress(socket=bus_server.socket, username="plain", password="pw")
        with Watch(address, ["k"], probe_s=PROBE_S) as watch:
            wait_until_heard(watch, 0.3)
            pid = pid_of(bus_server)
            with frozen(pid):
                frozen_ns = expect_nothing_new(watch, pid)
            wait_until(lambda: watch.heard.since_ns > frozen_ns)
            wait_until_heard(watch, 0.3)
