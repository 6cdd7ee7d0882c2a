"""What an operator asks of the recorder with a button, in virtual time: order, patience, and what is told."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.episode.storage.request import RecordAnswer, RecordRequest
from station.life.server import Life, ServerKind
from station.operator.requests import RecordButtons
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.virtual.written import Log

PATIENCE_S = 20.0
LATE_S = 0.3
KIND = ServerKind(name="teleop", role="command", summary="", config=msgspec.Struct, main=lambda config, life: 0)


class Place:
    """Buttons of an operator, and a recorder whose words the test chooses."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock, self.network = clock, Network(clock, (20_000, 200_000))
        self.log = Log(self.network)
        self.bus = Bus(self.network.address(), name="teleop", timeout_s=1.0)
        self._watch = self.bus.watch([keys.RECORDER])
        self.buttons = RecordButtons(
            Life(KIND, "teleop", self.bus, ""), self._watch, task="", instruction="", operator={"id": "ada"}
        )

    def recorder(self, state: str, *, answers_after_s: float | None) -> None:
        """Let a recorder say for ever what it does, and answer each request after a time; None for never."""

        def live() -> None:
            with Bus(self.network.address(), name="recorder", timeout_s=1.0) as bus, bus.watch([keys.RECORD]) as watch:
                newest, done = None, ""
                while True:
                    bus.publish({keys.RECORDER: codec.json_object({"state": state, "path": "data/walk/e"})})
                    newest = watch.wait(keys.RECORD, after=newest, timeout_s=0.5) or newest
                    asked = codec.parse_struct(newest.value, RecordRequest) if newest else None
                    if asked is not None and asked.id != done and answers_after_s is not None:
                        self.clock.sleep(answers_after_s)
                        bus.publish({keys.RECORD_ACK: codec.json_object(RecordAnswer(id=asked.id, ok=True))})
                        done = asked.id

        self._recorder = self.clock.spawn(live, "recorder")
        self.clock.sleep(1.0)

    def kill_recorder(self) -> None:
        self.clock.kill(self._recorder)

    def refused(self) -> list[tuple[float, str]]:
        return [(at_s, event.detail["reason"]) for at_s, event in self.log.events()
                if event.name == "operator-record-refused"]  # fmt: skip

    def asked(self) -> list[RecordRequest]:
        """Return the requests that stood on the bus, each once."""
        found = {(one := codec.parse_struct(write.value, RecordRequest)).id: one for write in self.log.of(keys.RECORD)}
        return list(found.values())


@contextmanager
def place() -> Iterator[Place]:
    with VirtualClock(1) as clock:
        yield Place(clock)


def test_where_no_recorder_runs_a_button_is_refused_at_once() -> None:
    with place() as here:
        pressed_s = here.clock.monotonic_s()
        here.buttons.press("record")
        here.clock.sleep(1.0)
        ((told_s, reason),) = here.refused()
    assert "no recorder runs" in reason
    assert told_s - pressed_s < LATE_S


def test_a_recorder_that_has_said_nothing_for_ten_seconds_is_none() -> None:
    with place() as here:
        here.recorder("recording", answers_after_s=0.1)
        here.kill_recorder()
        here.clock.sleep(9.0)
        here.buttons.press("mark")
        here.clock.sleep(PATIENCE_S + 1.0)
        assert [action.action for action in here.asked()] == ["mark"], "it may be on its way back"
        here.buttons.press("mark")
        here.clock.sleep(1.0)
        assert len(here.asked()) == 1
        assert "no recorder runs" in here.refused()[-1][1]


def test_one_that_does_not_answer_is_told_of_after_twenty_seconds_and_no_press_waits_for_ever() -> None:
    with place() as here:
        here.recorder("recording", answers_after_s=None)
        pressed_s = here.clock.monotonic_s()
        for _ in range(12):
            here.buttons.press("mark")
        here.clock.sleep(1.0)
        assert {reason for _, reason in here.refused()} == {"the recorder is still busy with what was asked before"}
        assert 3 <= len(here.refused()) <= 4, "one is being asked for, eight wait"
        here.clock.sleep(9 * (PATIENCE_S + LATE_S))
        late = [at_s for at_s, reason in here.refused() if "no recorder answered within 20 s" in reason]
    assert len(late) >= 8
    assert PATIENCE_S <= late[0] - pressed_s <= PATIENCE_S + LATE_S


def test_presses_are_done_in_their_order_each_after_the_answer_to_the_one_before() -> None:
    with place() as here:
        here.recorder("recording", answers_after_s=2.0)
        for action in ("mark", "success", "discard"):
            here.buttons.press(action)
        began_s = here.clock.monotonic_s()
        here.buttons.close(within_s=10.0)
        assert 6.0 <= here.clock.monotonic_s() - began_s < 8.0, "what was asked for is done before it hangs up"
        assert here.refused() == []
        asked = here.asked()
    assert [(one.action, one.success) for one in asked] == [("mark", None), ("mark", True), ("discard", None)]


def test_hanging_up_does_not_wait_for_a_recorder_that_does_not_answer() -> None:
    with place() as here:
        here.recorder("recording", answers_after_s=None)
        here.buttons.press("mark")
        began_s = here.clock.monotonic_s()
        here.buttons.close(within_s=2.0)
        assert 2.0 <= here.clock.monotonic_s() - began_s < 2.0 + LATE_S
