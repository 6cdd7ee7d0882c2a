"""Nothing moves without an edge of the button, good data and a picture of both sides; nothing ever jumps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from station import rotations
from station.operator import deltas
from station.operator.deadman import DeadMan, Snapshot
from station.operator.sample import Pose
from tests.examples import examples

HERE = Pose(np.array([0.1, 0.2, 1.0]), np.array([1.0, 0.0, 0.0, 0.0]))
THERE = Pose(np.array([0.4, 0.0, 0.2]), rotations.normalized([0.8, 0.1, -0.5, 0.3]))


def poses(seed: int) -> Pose:
    random = np.random.default_rng(seed)
    return Pose(random.uniform(-1, 1, 3), rotations.normalized(random.normal(size=4)))


def engaged() -> DeadMan[str, str]:
    deadman: DeadMan[str, str] = DeadMan()
    assert deadman.step(False, "operator", "robot") is None
    change = deadman.step(True, "operator", "robot")
    assert change is not None
    assert change.name == "operator-engaged"
    return deadman


def test_a_press_with_good_data_takes_a_picture_of_both_sides() -> None:
    assert engaged().snapshot == Snapshot("operator", "robot")


def test_a_button_that_was_held_before_anybody_looked_does_nothing() -> None:
    deadman: DeadMan[str, str] = DeadMan()
    for _ in range(5):
        assert deadman.step(True, "operator", "robot") is None
    assert not deadman.is_engaged


def test_letting_go_ends_it_in_the_same_tick() -> None:
    deadman = engaged()
    change = deadman.step(False, "operator", "robot")
    assert change is not None
    assert (change.name, change.reason, deadman.snapshot) == ("operator-disengaged", "released", None)


@pytest.mark.parametrize(
    ("held", "now", "why_blocked", "reason"),
    [
        (True, None, "", "no valid data from the device"),
        (None, "operator", "", "no valid data from the device"),
        (True, "operator", "emergency stop", "emergency stop"),
        (True, "operator", "bus lost", "bus lost"),
        (True, None, "pico is stale: 0.12 s", "pico is stale: 0.12 s"),
    ],
)
def test_what_comes_in_the_way_ends_it_and_holding_on_through_it_does_nothing_afterwards(
    held: bool | None, now: str | None, why_blocked: str, reason: str
) -> None:
    deadman = engaged()
    change = deadman.step(held, now, "robot", why_blocked=why_blocked)
    assert change is not None
    assert (change.name, change.reason) == ("operator-disengaged", reason)
    for _ in range(3):
        assert deadman.step(True, "operator", "robot") is None
    assert (deadman.state, deadman.reason) == ("spent", reason)
    assert deadman.step(False, "operator", "robot") is None
    change = deadman.step(True, "operator", "later")
    assert change is not None
    assert deadman.snapshot == Snapshot("operator", "later")


@pytest.mark.parametrize(
    ("now", "why_blocked", "why_not_engage", "reason"),
    [
        (None, "", "", "no valid data from the device"),
        (None, "body is not tracked", "", "body is not tracked"),
        ("operator", "", "elbow is 1.2 rad away", "elbow is 1.2 rad away"),
    ],
)
def test_pressing_without_what_it_takes_is_refused_with_the_reason(
    now: str | None, why_blocked: str, why_not_engage: str, reason: str
) -> None:
    deadman: DeadMan[str, str] = DeadMan()
    deadman.step(False, now, "robot")
    change = deadman.step(True, now, "robot", why_blocked=why_blocked, why_not_engage=why_not_engage)
    assert change is not None
    assert (change.name, change.reason) == ("operator-refused", reason)
    assert deadman.step(True, "operator", "robot") is None
    assert not deadman.is_engaged


def test_an_objection_ends_nothing_that_is_under_way() -> None:
    deadman = engaged()
    assert deadman.step(True, "operator", "robot", why_not_engage="elbow is 1.2 rad away") is None
    assert deadman.is_engaged


def test_the_other_button_turns_driving_on_and_off() -> None:
    deadman: DeadMan[str, str] = DeadMan()
    for toggled, is_engaged in [(False, False), (True, True), (False, True), (True, False), (True, True)]:
        deadman.step(False, "operator", "robot", toggled=toggled)
        assert deadman.is_engaged is is_engaged


def test_driving_that_was_turned_on_does_not_come_back_by_itself_after_a_gap() -> None:
    deadman: DeadMan[str, str] = DeadMan()
    deadman.step(False, "operator", "robot", toggled=True)
    deadman.step(None, None, "robot", why_blocked="pico is lost")
    for _ in range(3):
        assert deadman.step(False, "operator", "robot") is None
    assert not deadman.is_engaged


def test_a_jump_of_the_tracking_ends_it() -> None:
    deadman: DeadMan[dict[str, Pose], None] = DeadMan(deltas.jump)
    deadman.step(False, {"left": HERE}, None)
    deadman.step(True, {"left": HERE}, None)
    change = deadman.step(True, {"left": Pose(HERE.position + np.array([0.0, 0.31, 0.0]), HERE.quat_wxyz)}, None)
    assert change is not None
    assert change.reason == "left jumped 0.31 m between two samples (limit 0.3 m)"


def test_a_stop_from_outside_ends_it() -> None:
    deadman = engaged()
    change = deadman.disengage("exit")
    assert change is not None
    assert (change.reason, deadman.disengage("exit")) == ("exit", None)
    assert deadman.step(True, "operator", "robot") is None
    assert not deadman.is_engaged


class Session(RuleBasedStateMachine):
    """An operator who does anything, and a robot that goes where it is told."""

    @initialize()
    def begin(self) -> None:
        self.deadman: DeadMan[dict[str, Pose], Pose] = DeadMan(deltas.jump)
        self.hand: Pose | None = HERE
        self.target = THERE
        self.has_released = False  # since the last end, or the beginning
        self.was_engaged = False

    def tick(self, held: bool | None, *, why_blocked: str = "") -> None:
        now = None if self.hand is None else {"hand": self.hand}
        before = self.target
        change = self.deadman.step(held, now, self.target, why_blocked=why_blocked)
        is_engaged = self.deadman.is_engaged
        if is_engaged and not self.was_engaged:
            assert self.has_released, "it engaged without an edge"
            assert change is not None
            assert change.name == "operator-engaged"
        assert not (is_engaged and (why_blocked or held is not True or now is None)), "it drives against the rules"
        if self.deadman.snapshot is not None and self.hand is not None:
            start = self.deadman.snapshot.start["hand"]
            self.target = deltas.followed(self.deadman.snapshot.target, start, self.hand)
        if is_engaged and not self.was_engaged:
            assert np.abs(self.target.position - before.position).max() <= 1e-6
            assert deltas.angle_between(self.target.quat_wxyz, before.quat_wxyz) <= 1e-6
        if not is_engaged:
            assert self.target is before, "it moves while it is not engaged"
        if held is False:
            self.has_released = True
        elif self.was_engaged or is_engaged or held is None:
            self.has_released = False
        self.was_engaged = is_engaged

    @rule(held=st.booleans())
    def hold_still(self, held: bool) -> None:
        self.tick(held)

    @rule(held=st.booleans(), way=st.tuples(*[st.floats(-0.1, 0.1)] * 6))
    def move(self, held: bool, way: tuple[float, ...]) -> None:
        if self.hand is not None:
            turn = rotations.from_rotation_vector(np.array(way[3:]))
            self.hand = Pose(self.hand.position + way[:3], rotations.multiply(turn, self.hand.quat_wxyz))
        self.tick(held)

    @rule(held=st.booleans(), seed=st.integers(0, 50))
    def leap(self, held: bool, seed: int) -> None:
        was_there, was_engaged = self.hand, self.was_engaged
        self.hand = poses(seed)
        self.tick(held)
        if was_engaged and was_there is not None and deltas.jump({"hand": was_there}, {"hand": self.hand}):
            assert not self.deadman.is_engaged, "it drives on over a jump"

    @rule(held=st.sampled_from([True, False, None]))
    def lose_sight(self, held: bool | None) -> None:
        self.hand = None
        self.tick(held)

    @rule(held=st.booleans(), seed=st.integers(0, 50))
    def find_again(self, held: bool, seed: int) -> None:
        self.hand = self.hand or poses(seed)
        self.tick(held)

    @rule(held=st.booleans(), why_blocked=st.sampled_from(["emergency stop", "bus lost"]))
    def stop(self, held: bool, why_blocked: str) -> None:
        self.tick(held, why_blocked=why_blocked)

    @invariant()
    def there_is_a_picture_exactly_while_engaged(self) -> None:
        if hasattr(self, "deadman"):
            assert (self.deadman.snapshot is not None) is self.deadman.is_engaged


Session.TestCase.settings = settings(max_examples=examples(60), stateful_step_count=40, deadline=None)
TestSession = Session.TestCase
