"""A request is written again until it is answered, and none is lost to one that overwrites it."""

from __future__ import annotations

import threading

import msgspec
import pytest

from station.bus import codec
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import NotReady, Refused
from station.life import request
from station.life.arm_request import ArmRequest
from station.life.request import Asked, DoneRequests, NewRequests
from tests.waiting import wait_until

ASKED, ANSWERED = "station:asked", "station:answered"


class Request(msgspec.Struct, frozen=True, kw_only=True):
    id: str
    late_s: float = 0.0


def own_answer(data: bytes) -> Request | None:
    found = codec.parse_struct(data, Request)
    return found if found.id == "ours" else None


def test_one_that_another_has_overwritten_is_written_again_and_known_to_be_overtaken(bus_server: BusAddress) -> None:
    found: dict[str, Request] = {}

    def ask() -> None:
        with Bus(bus_server, name="asker", timeout_s=5.0) as bus, bus.watch([ANSWERED]) as watch:
            answers = {ANSWERED: own_answer}
            found.update(request.ask(bus, watch, ASKED, Request(id="ours"), answers, what="this", within_s=60.0))

    asker = threading.Thread(target=ask)
    with Bus(bus_server, name="server", timeout_s=5.0) as bus:
        asker.start()
        wait_until(lambda: bus.get(ASKED) is not None)
        with bus.watch([ASKED]) as watch:
            wait_until(lambda: watch.is_connected)
            new, done = NewRequests(watch, ASKED), DoneRequests[str]()
            bus.publish({ASKED: codec.json_object(Request(id="of another"))})
            overtaken: dict[str, bool] = {}

            def both_came() -> bool:
                if (asked := new.pop()) is not None:
                    wanted = request.parse(asked.data, Request, "one")
                    overtaken[wanted.id] = done.begin(asked.first_ns(wanted.late_s))
                return len(overtaken) == 2

            wait_until(both_came)
        assert overtaken == {"of another": False, "ours": True}
        for answered in ("of another", "ours"):
            bus.publish({ANSWERED: codec.json_object(Request(id=answered))})
        asker.join()
    assert found == {ANSWERED: Request(id="ours")}


def test_one_that_nobody_answers_is_given_up(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="asker", timeout_s=5.0) as bus, bus.watch([ANSWERED]) as watch:
        answers = {ANSWERED: own_answer}
        assert request.ask(bus, watch, ASKED, Request(id="ours"), answers, what="this", within_s=0.1) == {}
        assert bus.get(ASKED) is not None
    with pytest.raises(NotReady, match="this: the bus"), bus.watch([ANSWERED]) as watch:
        request.ask(bus, watch, ASKED, Request(id="ours"), answers, what="this", within_s=0.1)


def test_what_is_no_request_is_refused_by_name() -> None:
    assert request.parse(b'{"id": "a"}', Request, "a request") == Request(id="a")
    with pytest.raises(Refused, match=r"not a request: .*id"):
        request.parse(b"{}", Request, "a request")


@pytest.mark.parametrize("late_s", ["-0.1", "1e300"])
def test_one_that_was_late_by_no_time_that_can_be_is_refused(late_s: str) -> None:
    with pytest.raises(Refused, match=r"not an arm request: .*late_s"):
        request.parse(b'{"action": "arm", "late_s": %s}' % late_s.encode(), ArmRequest, "an arm request")


def test_answers_are_remembered_by_their_ids_the_newest_of_many() -> None:
    done = DoneRequests[int]()
    for number in range(100):
        done.put(str(number), number)
    done.put("", 7)
    assert [done.get(asked) for asked in ("99", "36", "35", "")] == [99, 36, None, None]


def test_a_request_is_overtaken_by_one_that_was_first_written_later_and_by_no_other() -> None:
    done = DoneRequests[int]()
    first = [Asked(b"", 1_000_000_000).first_ns(late_s) for late_s in (0.2, 0.5, 0.0, 0.0, 0.1)]
    assert [done.begin(first_ns) for first_ns in first] == [False, True, False, False, True]
