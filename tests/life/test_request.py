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
from station.life.request import AnswerMemory, NewValue
from tests.waiting import wait_until

ASKED, ANSWERED = "station:asked", "station:answered"


class Request(msgspec.Struct, frozen=True, kw_only=True):
    id: str


def own_answer(data: bytes) -> Request | None:
    found = codec.parse_struct(data, Request)
    return found if found.id == "ours" else None


def test_one_that_another_has_overwritten_is_written_again_until_it_is_answered(bus_server: BusAddress) -> None:
    found: dict[str, Request] = {}

    def ask() -> None:
        with Bus(bus_server, name="asker", timeout_s=5.0) as bus, bus.watch([ANSWERED]) as watch:
            answers = {ANSWERED: own_answer}
            found.update(request.ask(bus, watch, ASKED, Request(id="ours"), answers, what="this", within_s=60.0))

    asker = threading.Thread(target=ask)
    with Bus(bus_server, name="server", timeout_s=5.0) as bus:
        asker.start()
        wait_until(lambda: bus.get(ASKED) is not None)
        bus.publish({ASKED: codec.json_object(Request(id="of another"))})
        with bus.watch([ASKED]) as watch:
            asked = NewValue(watch, ASKED)
            wait_until(lambda: asked.take() == codec.json_object(Request(id="ours")))
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


def test_answers_are_remembered_by_their_ids_the_newest_of_many() -> None:
    memory = AnswerMemory[int]()
    for number in range(100):
        memory.put(str(number), number)
    memory.put("", 7)
    assert [memory.get(asked) for asked in ("99", "36", "35", "")] == [99, 36, None, None]
