"""A glove: each joint by its sensor, gently to it, then as fast as fingers are; a hand that is let go stays."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from adapters.commands.g1_parts import LEFT_HAND, RIGHT_HAND
from adapters.devices.glove.sensors import FINGERS
from adapters.drivers.glove import GENTLE_RAD_S, GloveDriver, GloveOptions, weights
from adapters.retarget.finger_bends import FIST_RAD
from station.errors import ConfigError
from station.operator.deadman import Snapshot
from station.operator.sample import OperatorSample
from station.protocols import Floats
from tests.adapters.retarget.test_finger_bends import hand as tracked

from .operators import TICK_S

EACH = tuple(f"{finger}_{part}" for finger in FINGERS for part in range(3))
OPEN, FIST = np.zeros(5), np.ones(5)


def engaged(command: str = "g1-left-hand", closed: Floats = OPEN, **options: object) -> tuple[GloveDriver, Snapshot]:
    driver = GloveDriver(GloveOptions(command=command, **options))  # type: ignore[arg-type]
    snapshot = Snapshot(closed, driver.target)
    driver.step(OperatorSample(joints=closed), snapshot, TICK_S)
    return driver, snapshot


def after(driver: GloveDriver, snapshot: Snapshot | None, closed: Floats, seconds: float) -> Floats:
    for _ in range(round(seconds / TICK_S)):
        asked = driver.step(OperatorSample(joints=closed), snapshot, TICK_S)
    return asked


@pytest.mark.parametrize(("command", "hand"), [("g1-left-hand", LEFT_HAND), ("g1-right-hand", RIGHT_HAND)])
def test_a_fist_closes_the_hand_and_an_open_hand_opens_it(command: str, hand: object) -> None:
    driver, snapshot = engaged(command)
    assert driver.command_format is hand
    np.testing.assert_allclose(after(driver, snapshot, FIST, 2.0), hand.closed)  # type: ignore[attr-defined]
    np.testing.assert_allclose(after(driver, snapshot, OPEN, 2.0), hand.opened)  # type: ignore[attr-defined]


def test_the_sides_are_mirror_images() -> None:
    left, right = (dict(zip((e.name[5:] for e in hand.elements), hand.closed, strict=True))
                   for hand in (LEFT_HAND, RIGHT_HAND))  # fmt: skip
    assert {name.removeprefix("_"): -q for name, q in right.items()} == pytest.approx(
        {name: q for name, q in left.items()}
    )


def test_one_finger_bends_and_the_others_stay() -> None:
    driver, snapshot = engaged()
    asked = after(driver, snapshot, np.array([0, 1, 0, 0, 0.0]), 2.0)
    names = [element.name for element in LEFT_HAND.elements]
    bent = {name for name, q in zip(names, asked, strict=True) if abs(q) > 0.01}
    assert bent == {"left_hand_index_0_pos", "left_hand_index_1_pos"}


def test_a_glove_with_a_sensor_for_each_joint_bends_each_by_its_own() -> None:
    driver, snapshot = engaged(closed=np.zeros(15))
    closed = np.zeros(15)
    closed[EACH.index("middle_1")] = 1.0
    asked = after(driver, snapshot, closed, 2.0)
    names = [element.name for element in LEFT_HAND.elements]
    assert {name for name, q in zip(names, asked, strict=True) if abs(q) > 0.01} == {"left_hand_middle_1_pos"}


def test_a_joint_without_a_sensor_of_its_own_follows_its_finger() -> None:
    only_ends = weights(LEFT_HAND, ("thumb", "index_1", "index_2", "middle_2"))
    rows = dict(zip(LEFT_HAND.fingers, only_ends.tolist(), strict=True))
    assert rows["index_0"] == [0, 0.5, 0.5, 0], "the mean of its finger"
    assert rows["index_1"] == [0, 1, 0, 0], "its own"
    assert rows["middle_0"] == [0, 0, 0, 1]
    assert rows["thumb_0"] == rows["thumb_1"] == [1, 0, 0, 0]


def test_a_hand_goes_gently_to_its_glove_and_then_as_fast_as_fingers() -> None:
    driver, snapshot = engaged(closed=FIST)
    before = driver.target
    for _ in range(round(0.6 / TICK_S)):
        asked = driver.step(OperatorSample(joints=FIST), snapshot, TICK_S)
        assert (np.abs(asked - before) <= GENTLE_RAD_S * TICK_S + 1e-9).all()
        before = asked
    np.testing.assert_allclose(after(driver, snapshot, FIST, 1.0), LEFT_HAND.closed)
    opened = after(driver, snapshot, OPEN, 0.26)
    np.testing.assert_allclose(opened, LEFT_HAND.opened, atol=1e-9)


def test_let_go_it_stays_and_goes_gently_again() -> None:
    driver, snapshot = engaged()
    closed = after(driver, snapshot, FIST, 2.0)
    np.testing.assert_array_equal(after(driver, None, OPEN, 1.0), closed)
    again = Snapshot(OPEN, driver.target)
    np.testing.assert_array_equal(driver.step(OperatorSample(joints=OPEN), again, TICK_S), closed)
    first = driver.step(OperatorSample(joints=OPEN), again, TICK_S)
    assert np.abs(first - closed).max() == pytest.approx(GENTLE_RAD_S * TICK_S)


def test_it_goes_on_from_where_the_hand_is() -> None:
    driver = GloveDriver(GloveOptions(command="g1-left-hand"))
    driver.resume_from(LEFT_HAND.closed * 0.5)
    np.testing.assert_array_equal(driver.step(None, None, TICK_S), LEFT_HAND.closed * 0.5)


@pytest.mark.parametrize(
    ("closed", "why_not"),
    [
        (None, "neither a glove's sensors nor a tracked left hand comes"),
        (np.zeros(16), "the glove sends 16 sensors, expected 5 or 15 numbers; say with sensors: what each is"),
        (np.full(5, np.nan), "the glove sends 5 sensors, expected 5 or 15 numbers"),
    ],
)
def test_a_glove_that_sends_something_else_is_told(closed: Floats | None, why_not: str) -> None:
    found = GloveDriver(GloveOptions(command="g1-left-hand")).inspect(OperatorSample(joints=closed))
    assert found.input is None
    assert found.why_not.startswith(why_not)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_tracked_hand_bends_the_hand_of_its_side_as_a_glove_of_15_does(side: Literal["left", "right"]) -> None:
    fist, other = tracked(FIST_RAD), tracked(np.zeros((5, 3)))
    driver = GloveDriver(GloveOptions(command=f"g1-{side}-hand"))
    sample = OperatorSample(hands={"left": fist, "right": other} if side == "left" else {"left": other, "right": fist})
    snapshot = Snapshot(driver.inspect(sample).input, driver.target)
    for _ in range(round(2.0 / TICK_S)):
        asked = driver.step(sample, snapshot, TICK_S)
    np.testing.assert_allclose(asked, driver.command_format.closed, atol=1e-9)
    only_other = OperatorSample(hands={"right" if side == "left" else "left": fist})
    assert driver.inspect(only_other).why_not.endswith(f"nor a tracked {side} hand comes")
    np.testing.assert_array_equal(driver.step(only_other, snapshot, TICK_S), asked, err_msg="it stays")


def test_a_sensor_that_jumps_is_named() -> None:
    driver = GloveDriver(GloveOptions(command="g1-left-hand"))
    now = np.array([0, 0.8, 0, 0, 0.1])
    assert (
        driver.jump(OPEN, now) == "index of the glove jumped by 0.80 of its whole way between two samples (limit 0.7)"
    )
    assert driver.jump(now, now) == ""
    assert driver.jump(OPEN, np.zeros(15)) == "the glove sends 15 sensors and no more 5"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"command": "g1-left-arm"}, "'g1-left-arm' is not that of a hand"),
        ({"command": "g1-left-hand", "sensors": ("thumb", "index")}, "none of thumb, index bends middle_0"),
    ],
)
def test_what_cannot_be_driven_is_refused_in_a_line(options: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        GloveDriver(GloveOptions(**options))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"command": "g1-left-hend"}, "did you mean 'g1-left-hand'"),
        ({"sensors": ("thumb", "toe")}, "sensors: 'toe' is no sensor; expected one of thumb, index"),
        ({"sensors": ("thumb", "thumb")}, "sensors: sensor thumb comes twice"),
        ({"speed_rad_s": 0.0}, "speed_rad_s is 0; expected 0.1 to 20"),
    ],
)
def test_a_setting_that_cannot_be_is_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        GloveOptions(**({"command": "g1-left-hand"} | options))  # type: ignore[arg-type]
