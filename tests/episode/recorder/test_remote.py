"""Asking a recorder: an answer is found though the next one was given before anybody could read it."""

from __future__ import annotations

import threading

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.recorder import remote
from station.episode.storage.request import RecordAnswer, parse_answer, parse_request
from tests.waiting import wait_until


def test_an_answer_that_the_next_one_has_overwritten_is_found(bus_server: BusAddress) -> None:
    with (
        Bus(bus_server, name="g1", timeout_s=5.0) as asker,
        Bus(bus_server, name="recorder", timeout_s=5.0) as recorder,
    ):

        def answer() -> None:
            wait_until(lambda: recorder.get(keys.RECORD) is not None)
            asked = parse_request(recorder.get(keys.RECORD) or b"")
            ours = RecordAnswer(id=asked.id, ok=True, path="/data/walk")
            newest = RecordAnswer(id="of another", ok=True, earlier=(ours,))
            recorder.publish({keys.RECORD_ACK: codec.json_object(newest)})

        thread = threading.Thread(target=answer)
        thread.start()
        assert remote.ask(asker, "start", timeout_s=60.0).path == "/data/walk"
        thread.join()


def test_what_holds_no_answer_to_a_request_says_so() -> None:
    newest = RecordAnswer(id="a", ok=True, earlier=(RecordAnswer(id="b", ok=False, reason="so"),))
    data = codec.json_object(newest)
    found = parse_answer(data, "b")
    assert found is not None
    assert (found.ok, found.reason) == (False, "so")
    assert parse_answer(data, "c") is None
    assert parse_answer(b"odd", "a") is None
