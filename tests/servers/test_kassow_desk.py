"""What is asked of an arm's controller is answered, however it ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from servers.kassow import RequestHandler
from station.bus import codec
from station.life.controller_request import Action, ControllerAnswer, ControllerRequest
from station.life.request import OVERTAKEN, Asked
from tests.adapters.robots.kassow.driven_arm import DrivenArm
from tests.waiting import wait_until

ROBOT = "kassow_kr810"


@pytest.fixture
def arm(kord: Any) -> Iterator[DrivenArm]:
    made = DrivenArm(kord)
    yield made
    made.session.close()


@pytest.fixture
def desk(arm: DrivenArm) -> RequestHandler:
    return RequestHandler(arm.control, arm.session, ROBOT)


def request(action: Action, number: str, **wanted: Any) -> Asked:
    data = codec.json_object(ControllerRequest(action=action, id=number, robot=ROBOT, who="ada", **wanted))
    return Asked(data, time.monotonic_ns())


def answer_to(desk: RequestHandler, number: str) -> ControllerAnswer:
    """Look as the server does, tick by tick, until a request is answered."""
    found: list[ControllerAnswer] = []

    def look() -> bool:
        answer = desk.poll()
        if answer is not None and answer.id == number:
            found.append(answer)
        return bool(found)

    wait_until(look)
    return found[0]


@pytest.mark.parametrize("kind", [MemoryError, RuntimeError, OSError])
def test_a_clear_that_fails_in_a_way_that_nobody_foresaw_is_told_and_another_may_be_tried(
    arm: DrivenArm, desk: RequestHandler, monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    def fail(_: float) -> None:
        raise kind("of the library,\nin two lines")

    with monkeypatch.context() as broken:
        broken.setattr(arm.bridge, "clear_faults", fail)
        desk.on_request(request("clear", "a"))
        refused = answer_to(desk, "a").refused
    assert refused.startswith(f"clearing failed: {kind.__name__}: ")
    assert "\n" not in refused
    assert "clear-refused" in [step_event.name for step_event in arm.step(None).step_events]
    desk.on_request(request("clear", "b"))
    assert answer_to(desk, "b").refused == ""


def test_a_clear_for_which_the_system_has_no_thread_is_told(
    desk: RequestHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none_left(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", none_left)
    desk.on_request(request("clear", "a"))
    assert "can't start new thread" in answer_to(desk, "a").refused


def test_a_second_clear_is_refused_while_the_first_goes_on_and_both_are_answered(
    arm: DrivenArm, desk: RequestHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    clear = arm.bridge.clear_faults

    def wait_and_clear(deadline_s: float) -> Any:
        go_on.wait(60.0)
        return clear(deadline_s)

    monkeypatch.setattr(arm.bridge, "clear_faults", wait_and_clear)
    desk.on_request(request("clear", "a"))
    desk.on_request(request("clear", "b"))
    assert answer_to(desk, "b").refused == "its faults are being cleared already"
    go_on.set()
    assert answer_to(desk, "a").refused == ""


def test_a_request_that_is_written_again_is_answered_again_and_done_once(
    arm: DrivenArm, desk: RequestHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, throttle = list[int](), arm.session.throttle

    def noted(ticks: int) -> str:
        done.append(ticks)
        return throttle(ticks)

    monkeypatch.setattr(arm.session, "throttle", noted)
    for number in range(1, 60):
        desk.on_request(request("throttle", str(number), throttle=number))
    for number in (1, 30, 59):
        desk.on_request(request("throttle", str(number), throttle=number))
        assert answer_to(desk, str(number)).refused == ""
    assert done == list(range(1, 60))
    wait_until(lambda: arm.step(None) is not None and arm.bridge.get_state().throttle == 59)


def test_a_request_that_was_overtaken_by_another_is_refused(arm: DrivenArm, desk: RequestHandler) -> None:
    desk.on_request(request("throttle", "later", throttle=5))
    desk.on_request(request("throttle", "first", throttle=2, late_s=0.5))
    assert answer_to(desk, "first").refused == OVERTAKEN
    wait_until(lambda: arm.step(None) is not None and arm.bridge.get_state().throttle == 5)


def test_a_clear_that_is_written_again_while_it_goes_on_is_no_second_one(
    arm: DrivenArm, desk: RequestHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, clears, clear = threading.Event(), list[float](), arm.bridge.clear_faults

    def wait_and_clear(deadline_s: float) -> Any:
        clears.append(deadline_s)
        go_on.wait(60.0)
        return clear(deadline_s)

    monkeypatch.setattr(arm.bridge, "clear_faults", wait_and_clear)
    for _ in range(3):
        desk.on_request(request("clear", "a"))
    assert desk.poll() is None
    go_on.set()
    assert answer_to(desk, "a").refused == ""
    desk.on_request(request("clear", "a"))
    assert answer_to(desk, "a").refused == ""
    assert len(clears) == 1


def test_a_clear_ends_driving_and_who_drove_has_to_let_go(arm: DrivenArm, desk: RequestHandler) -> None:
    arm.drive(20)
    desk.on_request(request("clear", "a"))
    record = arm.drive(1)
    assert record.decision.state == "waiting"
    assert record.decision.reason == "the controller's faults are being cleared; let go, then engage anew"
    assert answer_to(desk, "a").refused == ""
    sends = arm.bridge.get_state().stream_j_sends
    events = [step_event.name for _ in range(100) for step_event in arm.drive(1).step_events]
    assert events == ["controller-cleared"]
    assert arm.bridge.get_state().stream_j_sends == sends


def test_requests_to_another_arm_and_what_is_none_are_not_answered(desk: RequestHandler) -> None:
    for data in (b"hello", codec.json_object(ControllerRequest(action="clear", id="a", robot="kassow_other"))):
        desk.on_request(Asked(data, 1))
    assert desk.poll() is None


@pytest.mark.parametrize("ticks", [0, 251, 1 << 31, -(1 << 31) - 1, (1 << 63) - 1])
def test_a_throttle_that_is_no_number_of_ticks_is_refused_however_large_it_is(
    arm: DrivenArm, desk: RequestHandler, ticks: int
) -> None:
    before = arm.bridge.get_state().throttle
    desk.on_request(request("throttle", "a", throttle=ticks))
    assert "throttle" in answer_to(desk, "a").refused
    assert arm.bridge.get_state().throttle == before
