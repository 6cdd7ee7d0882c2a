"""What joints did, from numbers alone: late, reversed, swapped, and bits that came."""

from __future__ import annotations

import numpy as np
import pytest

from station.protocols import Floats
from station.supervision.joint_response import bits, follows

NAMES = ("one", "other")
TIME_S = np.arange(200) * 0.02
TURN = slice(50, 150)


def led() -> Floats:
    """Return targets of two joints of which the first is led for 2 s, shape (200, 2) [rad]."""
    asked = np.zeros((200, 2))
    asked[TURN, 0] = 0.05 * np.sin(2.0 * np.pi * np.arange(100) / 100)
    return asked


@pytest.mark.parametrize("late", [0, 10, 20])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_comes_late_and_not_as_far_is_told_from_one_that_moves_the_wrong_way(
    late: int, sign: float
) -> None:
    asked = led()
    measured = 0.5 + sign * 0.3 * np.roll(asked, late, axis=0) + 0.01 * TIME_S[:, None]
    (found,) = follows(TIME_S, asked, measured, NAMES)
    assert found.is_good == (sign > 0.0)
    assert found.numbers["answers"] == pytest.approx(sign * 0.3, abs=0.02)
    assert found.text.startswith("moved by" if sign > 0.0 else "it moved the wrong way: moved by")


def test_the_next_joint_s_turn_is_not_taken_for_this_one_s_where_rows_lack() -> None:
    asked, rest = np.zeros((200, 2)), 15
    for joint, begins in enumerate((10, 10 + 60 + rest)):
        asked[begins : begins + 60, joint] = 0.05 * np.sin(2.0 * np.pi * np.arange(60) / 60)
    measured = np.roll(asked, 3, axis=0) * (0.4, 1.0)  # an elbow carries a forearm, a wrist but a hand
    came = np.r_[0:71, 84:200]  # a busy machine saw nothing of the rest between both
    for found in follows(TIME_S[came], asked[came], measured[came], NAMES):
        assert found.is_good, found.text


@pytest.mark.parametrize(
    ("own", "other", "said"),
    [(0.0, 0.4, "other moved in its place"), (0.4, 0.3, "other moved with it"), (0.0, 0.0, "it did not follow")],
)
def test_who_moved_is_named(own: float, other: float, said: str) -> None:
    asked = led()
    (found,) = follows(TIME_S, asked, asked[:, :1] * (own, other), NAMES)
    assert (found.name, found.is_good) == ("one", False)
    assert found.text.startswith(f"{said}: ")


def test_who_is_not_led_is_not_judged() -> None:
    assert follows(TIME_S, np.zeros((200, 2)), led(), NAMES) == []


def test_bits_are_told_with_when_they_came_first_and_whose_they_are() -> None:
    words = np.zeros((200, 2))
    words[100:, 1], words[150:, 0] = 0x40000000 + 1, 1
    assert bits(TIME_S, words, NAMES).text == (
        "0x1 after 2.00 s, 2 of 2, first other; 0x40000000 after 2.00 s, 1 of 2, first other"
    )
    assert bits(TIME_S, np.zeros((200, 2)), NAMES).text == "none"
