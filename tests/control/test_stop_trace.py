"""A stop that was overwritten or deleted before it was read is a stop."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.control.command_receiver import CommandWatch
from station.control.stop_trace import StopTrace
from station.life import estop
from tests.bus.proxy import Proxy
from tests.waiting import wait_until

STOP, RELEASE = b"1", b"0"
KEY, PRESSED, OTHER = keys.ESTOP, keys.ESTOP_PRESSED, "other"
Request = Sequence[str | bytes]

HIDDEN: dict[str, list[Request]] = {
    "overwritten": [["SET", KEY, STOP], ["SET", KEY, RELEASE]],
    "overwritten twice": [["SET", KEY, STOP], ["SET", KEY, b""], ["SET", KEY, RELEASE]],
    "deleted": [["SET", KEY, STOP], ["DEL", KEY]],
    "unlinked": [["SET", KEY, STOP], ["UNLINK", KEY]],
    "taken": [["SET", KEY, STOP], ["GETDEL", KEY]],
    "in a transaction": [["MULTI"], ["SET", KEY, STOP], ["SET", KEY, RELEASE], ["EXEC"]],
    "expired": [["SET", KEY, STOP, "PX", "1"]],
    "renamed away": [["SET", KEY, STOP], ["RENAME", KEY, OTHER]],
    "overwritten by a rename": [["SET", OTHER, RELEASE], ["SET", KEY, STOP], ["RENAME", OTHER, KEY]],
    "overwritten by a copy": [["SET", OTHER, RELEASE], ["SET", KEY, STOP], ["COPY", OTHER, KEY, "REPLACE"]],
    "moved": [["SET", KEY, STOP], ["MOVE", KEY, "5"]],
    "flushed": [["SET", KEY, STOP], ["FLUSHALL"]],
    "pressed, and that removed": [["SET", PRESSED, STOP], ["DEL", PRESSED]],
    "pressed for a moment": [["SET", PRESSED, STOP, "PX", "1"]],
    "pressed with the value of a release": [["SET", PRESSED, RELEASE]],
    "pressed and released": [["SET", PRESSED, STOP], ["DEL", PRESSED], ["SET", KEY, RELEASE]],
    "spelled otherwise": [["MSET", KEY, STOP], ["APPEND", KEY, b"!"], ["SETRANGE", KEY, "0", "0"], ["SET", KEY, b"0"]],
}
"""What any client can write at once: a stop, and what hides it."""


@pytest.fixture
def line(bus_server: BusAddress) -> Iterator[Connection]:
    connection = Connection(bus_server, timeout_s=5.0)
    yield connection
    connection.close()


@pytest.mark.parametrize("before", [None, STOP, RELEASE], ids=["absent", "stopped", "released"])
def test_a_stop_that_is_hidden_at_once_is_a_stop(
    bus_server: BusAddress, line: Connection, before: bytes | None
) -> None:
    for how, requests in HIDDEN.items():
        line.call("FLUSHALL")
        if before is not None:
            line.call("SET", KEY, before)
        with CommandWatch(bus_server, [*estop.KEYS, "command"], key="command") as watch:
            wait_until(lambda: watch.is_connected)
            line.pipeline(requests)
            wait_until(watch.urgent.is_set)
            news = watch.pop_stop()
            assert news is not None, how
            assert news.request.stop, how


def test_a_release_and_a_deletion_alone_are_no_stop(bus_server: BusAddress, line: Connection) -> None:
    with CommandWatch(bus_server, [*estop.KEYS, "command"], key="command") as watch:
        wait_until(lambda: watch.is_connected)
        line.call("SET", KEY, STOP)
        wait_until(lambda: (news := watch.pop_stop()) and news.request.stop)
        for release in (RELEASE, b'{"stop": false, "arm": true}', RELEASE):
            line.call("SET", KEY, release)
            wait_until(lambda: (news := watch.pop_stop()) and not news.request.stop)
        for request in (["EXPIRE", KEY, "100"], ["PERSIST", KEY], ["DEL", KEY], ["FLUSHALL"], ["SET", "command", "1"]):
            line.call(*request)
        wait_until(lambda: watch.latest("command"))
        assert watch.pop_stop() is None


@pytest.mark.parametrize("again", [RELEASE, b'{"stop": false}'])
def test_what_is_written_while_the_watch_is_cut_off_is_a_stop_whatever_it_is(
    bus_server: BusAddress, line: Connection, again: bytes
) -> None:
    with Proxy(bus_server) as network, CommandWatch(network.address, estop.KEYS, key="command") as watch:
        line.call("SET", KEY, b"0 ")
        wait_until(lambda: (sample := watch.latest(KEY)) is not None and sample.value == b"0 ")
        watch.begin_stops()
        network.cut()
        line.pipeline([["SET", KEY, STOP], ["SET", KEY, again]])
        network.mend()
        wait_until(lambda: (news := watch.pop_stop()) and news.request.stop and news.is_release_refused)


def test_a_stop_goes_before_a_release_that_comes_before_it_is_acted_on() -> None:
    trace = StopTrace()
    for value in (STOP, RELEASE):
        trace.on_event(KEY, b"set")
        trace.on_read(KEY, value, is_new=True)
    news = trace.pop()
    assert news is not None
    assert (news.request.stop, news.is_release_refused) == (True, True)
    assert not trace.has_news


WRITE = st.sampled_from([STOP, RELEASE, b"", b"stop", None])


@given(st.lists(st.tuples(st.sampled_from(estop.KEYS), WRITE, st.booleans(), st.booleans())))
def test_no_stop_is_lost_whatever_is_written_and_whenever_it_is_read(
    steps: list[tuple[str, bytes | None, bool, bool]],
) -> None:
    """Each step writes or deletes a key; then the reader may read both, with every event told of, and may take."""
    trace, held, is_owed = StopTrace(), dict[str, bytes | None](), False
    for key, written, is_read, is_taken in [*steps, (KEY, None, True, True)]:
        trace.on_event(key, b"del" if written is None else b"set")
        held[key] = written
        is_owed = is_owed or written in (STOP, b"stop") or (key == PRESSED and written is not None)
        if not is_read:
            continue
        for each in estop.KEYS:
            trace.on_read(each, held.get(each), is_new=each == key and written is not None)
        if is_taken:
            news = trace.pop()
            if is_owed:
                assert news is not None
                assert news.request.stop
            is_owed = False


def test_a_press_that_is_followed_at_once_by_its_release_leaves_the_robot_stopped_and_says_so() -> None:
    trace = StopTrace()
    for key, events in ((PRESSED, [b"set", b"del"]), (KEY, [b"set"])):
        for event in events:
            trace.on_event(key, event)
    trace.on_read(PRESSED, None, is_new=False)
    trace.on_read(KEY, RELEASE, is_new=True)
    news = trace.pop()
    assert news is not None
    assert (news.request.stop, news.is_release_refused) == (True, True)


def test_events_that_leave_nothing_new_count_for_nothing_and_an_unknown_one_for_a_write() -> None:
    trace = StopTrace()
    for event in (b"del", b"expired", b"keymiss", b"rename_from", b"persist"):
        trace.on_event(KEY, event)
    assert not trace.may_have_missed(KEY, None)
    trace.on_event(KEY, b"of a later server")
    assert trace.may_have_missed(KEY, None)
    assert trace.may_have_missed(KEY, RELEASE)
    assert not trace.may_have_missed(KEY, STOP), "an ordinary stop is not held up by a question"
