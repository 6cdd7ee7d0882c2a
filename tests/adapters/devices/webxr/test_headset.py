"""Whose page drives, how old its frames are, and when the operator has let go; time is given."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from adapters.devices.webxr.controls import SENT
from adapters.devices.webxr.frame import PARTS, packed
from adapters.devices.webxr.headset import GIVEN_UP_S, LET_GO_S, OLD_S, Headset
from station import rotations
from station.clock import Clock
from station.operator.sample import OperatorSample, Pose

LEVEL = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
PARTS_OF_PAIR = sum(PARTS[name] for name in ("head", "left", "right", "controls_left", "controls_right"))
TICK_S = 0.01


class Given(Clock):
    """A clock that the test turns."""

    def __init__(self) -> None:
        self.now_s = 5_000.0

    def monotonic_ns(self) -> int:
        return round(self.now_s * 1e9)


class Page:
    """A page with a clock of its own.

    Args:
        ahead_s: How far its clock is ahead [s].
        ppm: How much faster it runs.
        trip_s: How long a message takes, there and back [s].
    """

    def __init__(self, headset: Headset, clock: Given, ahead_s: float = 0.0, ppm: float = 0.0, trip_s: float = 0.0):
        self.headset, self.clock, self.ahead_s, self.ppm, self.trip_s = headset, clock, ahead_s, ppm, trip_s
        self.number = headset.join()
        self.began_s = clock.now_s

    def ms(self, at_s: float | None = None) -> float:
        at = self.clock.now_s if at_s is None else at_s
        return (at + self.ahead_s + (at - self.began_s) * self.ppm * 1e-6) * 1e3

    def tell_time(self, share: float = 0.5) -> None:
        """Answer for the clock; of the trip this share is the way there."""
        number = self.headset.ping(self.number)
        at_ms = self.ms(self.clock.now_s + share * self.trip_s)
        self.clock.now_s += self.trip_s
        self.headset.pong(self.number, number, at_ms)

    def send(self, taken_s: float | None = None, **controls: float) -> None:
        """Send a frame, of now or of before."""
        at = self.ms(taken_s)
        values = [controls.get(name, 0.0) for name in SENT]
        self.headset.on_frame(self.number, packed(
            parts=PARTS_OF_PAIR, taken_ms=at, sent_ms=at, head=LEVEL, left=LEVEL, right=LEVEL, controls=[*values, 0.0],
        ))  # fmt: skip


@pytest.fixture
def clock() -> Given:
    return Given()


@pytest.fixture
def headset(clock: Given) -> Headset:
    return Headset(clock, where="http://127.0.0.1:1/")


@pytest.fixture
def page(headset: Headset, clock: Given) -> Page:
    made = Page(headset, clock, ahead_s=3600.0)
    made.tell_time()
    return made


def reading(headset: Headset) -> OperatorSample:
    found = headset.read()
    assert found is not None
    return found


def test_a_sample_is_given_once(page: Page, headset: Headset, clock: Given):
    page.send(right_grip=1.0)
    found = reading(headset)
    assert found.right is not None
    assert found.capture_ns == pytest.approx(clock.monotonic_ns(), abs=2e3)
    assert headset.read() is None


def test_the_same_animation_frame_is_no_new_sample(page: Page, headset: Headset, clock: Given):
    at_s = clock.now_s
    page.send(at_s)
    reading(headset)
    clock.now_s += TICK_S
    page.send(at_s)
    assert headset.read() is None


def test_before_a_clock_is_known_nothing_counts(headset: Headset, clock: Given):
    page = Page(headset, clock)
    page.send()
    assert headset.read() is None
    page.tell_time()
    page.send()
    assert headset.read() is not None


def test_x3_what_a_line_held_back_is_not_obeyed(page: Page, headset: Headset, clock: Given):
    page.send()
    reading(headset)
    began_s = clock.now_s
    clock.now_s += 1.0
    for late in range(60):
        page.send(began_s + late / 60.0)
    newest = headset.read()
    assert headset.old == pytest.approx(54, abs=1)
    assert newest is not None  # the last ones are young enough
    assert clock.monotonic_ns() - (newest.capture_ns or 0) < OLD_S * 1e9


@pytest.mark.parametrize("ahead_s", [-3600.0, 0.0, 3600.0])
@pytest.mark.parametrize("ppm", [-200.0, 0.0, 200.0])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_x4_an_age_is_right_within_half_a_trip_whatever_the_page_s_clock(
    headset: Headset, clock: Given, ahead_s: float, ppm: float, share: float
):
    page = Page(headset, clock, ahead_s, ppm, trip_s=0.03)
    wrong_s = []
    for _ in range(400):  # 100 s
        page.tell_time(share)
        clock.now_s += 0.22
        taken_s = clock.now_s
        page.send()
        found = reading(headset)
        wrong_s.append(abs((found.capture_ns or 0) * 1e-9 - taken_s))
    assert max(wrong_s) < 0.015 + 0.004  # half a trip, and what 200 ppm make of it in 16 s
    assert headset.old == 0


@pytest.mark.parametrize("step_s", [-30.0, 0.5, 30.0])
def test_x4_after_a_step_of_its_clock_frames_count_again_once_it_was_asked(
    page: Page, headset: Headset, clock: Given, step_s: float
):
    page.send()
    reading(headset)
    page.ahead_s += step_s
    clock.now_s += TICK_S
    page.send()
    assert (headset.read(), headset.old) == (None, 1)
    page.tell_time()
    clock.now_s += TICK_S
    page.send()
    assert headset.read() is not None


def step(page: Page, headset: Headset, clock: Given, **controls: float) -> OperatorSample | None:
    clock.now_s += TICK_S
    page.send(**controls)
    return headset.read()


def test_x2_who_lets_go_holds_nothing_for_a_moment_and_then_only_what_was_seen_released(
    page: Page, headset: Headset, clock: Given
):
    held = {"right_grip": 1.0, "left_stick_y": 0.7}
    first = step(page, headset, clock, **held)
    assert first is not None
    headset.let_go(page.number, "the menu is open")
    ends_s = clock.now_s + LET_GO_S
    while clock.now_s < ends_s - 1.5 * TICK_S:
        found = step(page, headset, clock, **held)  # a page that goes on sending does not undo it
        assert found is not None
        assert (found.left, found.right, set(found.controls.values())) == (None, None, {0.0})
    for _ in range(5):
        found = step(page, headset, clock, **held)
    assert found is not None
    assert found.right is not None
    assert found.controls["right_grip"] == 0.0
    step(page, headset, clock, left_stick_y=0.7)  # the grip is released
    found = step(page, headset, clock, **held)
    assert found is not None
    assert found.controls["right_grip"] == 1.0
    assert found.controls["left_stick_y"] == 0.0


def test_a_page_that_never_drove_lets_go_of_nothing(headset: Headset, clock: Given):
    page = Page(headset, clock)
    headset.let_go(page.number, "hidden")
    assert headset.read() is None


def test_x6_a_second_page_is_refused_until_the_first_is_silent_for_long(page: Page, headset: Headset, clock: Given):
    page.send()
    assert headset.join() == 0
    clock.now_s += GIVEN_UP_S + 0.1
    second = Page(headset, clock, ahead_s=3600.0)
    assert second.number
    assert not headset.is_driving(page.number)
    second.tell_time()
    page.send()  # the first one wakes up
    assert headset.read() is None
    second.send()
    assert headset.read() is not None


def test_a_palm_is_where_the_table_has_it_in_a_controller_of_that_profile(clock: Given):
    palm = Pose(np.array([0.01, 0.02, -0.03]), rotations.from_rotation_vector([0.1, 0.2, 0.3]))
    headset = Headset(clock, {"touch-plus": palm})
    page = Page(headset, clock)
    page.tell_time()
    page.send()
    plain = reading(headset)
    headset.about(page.number, {"left_input": "touch-plus", "right_input": "touch-plus"})
    clock.now_s += TICK_S
    page.send()
    found = reading(headset)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        before, after = getattr(plain, side), getattr(found, side)
        np.testing.assert_allclose(after.position - before.position, [0.01, sign * 0.02, -0.03], atol=1e-9)
        np.testing.assert_allclose(rotations.rotation_vector(after.quat_wxyz), [sign * 0.1, 0.2, sign * 0.3], atol=1e-6)


def test_a_page_that_is_gone_says_so(page: Page, headset: Headset, clock: Given):
    page.send()
    headset.leave(page.number)
    found = reading(headset)
    assert found.right is None
    clock.now_s += LET_GO_S
    assert headset.read() is None
    assert headset.why_silent().startswith("no page drives; the page is gone: open http://127.0.0.1:1/ in ")
    assert "`station pair`" in headset.why_silent()


WORDS = ("frame", "ping", "pong", "let-go", "about", "leave", "join")


def _held(at_ms: float) -> bytes:
    """Return a frame in which everything is held."""
    return packed(parts=PARTS["controls_left"] | PARTS["controls_right"], taken_ms=at_ms, sent_ms=at_ms, controls=1.0)


SECONDS = st.sampled_from([0.0, 0.001]) | st.floats()
SAID = st.tuples(st.sampled_from(WORDS), st.just(b"") | st.binary(max_size=40), SECONDS, st.integers(-3, 20))


@given(st.lists(SAID))
@example([("ping", b"", 0.0, 0), ("pong", b"", 0.0, 1), ("frame", b"", 0.0, 0)])  # one that is taken
def test_whatever_a_page_says_nothing_is_held_by_it(words: list[tuple[str, bytes, float, int]]):
    clock = Given()
    headset = Headset(clock)
    page = headset.join()
    acts: dict[str, Any] = {
        "frame": lambda data, value, number: headset.on_frame(page, _held((clock.now_s + value) * 1e3) + data[:1]),
        "ping": lambda data, value, number: headset.ping(page),
        "pong": lambda data, value, number: headset.pong(page, number, (clock.now_s + value) * 1e3),
        "let-go": lambda data, value, number: headset.let_go(page, str(data)),
        "about": lambda data, value, number: headset.about(page, {str(data): str(value)}),
        "leave": lambda data, value, number: headset.leave(number),
        "join": lambda data, value, number: headset.join(),
    }  # fmt: skip
    for what, data, value, number in words:
        acts[what](data, value, number)
        clock.now_s += 0.001
        found = headset.read()
        assert found is None or not any(found.controls.values()), "none of it has been seen at rest"
    assert isinstance(headset.why_silent(), str)
