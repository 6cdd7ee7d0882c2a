"""Fingers of a tracked hand: whatever way the hand is turned, its bends are those of its bones."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.devices.glove.sensors import FINGERS, PRESETS
from adapters.retarget.finger_bends import FIST_RAD, STRAIGHT_RAD, closed
from station import rotations
from station.bus.joints import HAND_26
from station.protocols import Floats

NAMES = PRESETS[15]
BONES_M = (0.06, 0.04, 0.03, 0.02)


def hand(bent_rad: Floats, turned: Floats | None = None) -> Floats:
    """A hand whose fingers lie side by side, bent by so much, shape (5, 3) [rad], and turned as a whole, shape (4,)."""
    joints = np.zeros((26, 7))
    joints[:, 3] = 1.0
    for number, finger in enumerate(FINGERS):
        names = [name for name in HAND_26 if name.startswith(finger)]
        if finger == "thumb":
            names = ["wrist", *names]
        place, angle = np.array([0.0, 0.02 * number if finger != "thumb" else 0.0, 0.0]), 0.0
        joints[HAND_26.index(names[0]), :3] = place
        for name, length, bend in zip(names[1:], BONES_M, [0.0, *bent_rad[number]], strict=True):
            angle += bend
            place = place + length * np.array([np.cos(angle), 0.0, -np.sin(angle)])
            joints[HAND_26.index(name), :3] = place
    if turned is not None:
        joints[:, :3] = [rotations.rotate(turned, place) for place in joints[:, :3]]
        joints[:, :3] += [0.3, -0.2, 1.1]
    return joints


TURNS = [None, *(rotations.normalized(row) for row in np.random.default_rng(3).normal(size=(4, 4)))]


@pytest.mark.parametrize("turned", TURNS)
def test_a_flat_hand_is_open_and_a_fist_is_closed_whichever_way_it_is_turned(turned: Floats | None) -> None:
    np.testing.assert_array_equal(closed(hand(np.zeros((5, 3)), turned)), np.zeros(15))
    np.testing.assert_array_equal(closed(hand(np.full((5, 3), STRAIGHT_RAD - 0.01), turned)), np.zeros(15))
    np.testing.assert_allclose(closed(hand(FIST_RAD, turned)), np.ones(15))
    np.testing.assert_array_equal(closed(hand(FIST_RAD + 0.2, turned)), np.ones(15))


@pytest.mark.parametrize("place", range(15))
def test_each_joint_has_a_place_of_its_own_that_a_glove_calls_the_same(place: int) -> None:
    finger, joint = divmod(place, 3)
    bent = np.zeros((5, 3))
    bent[finger, joint] = (STRAIGHT_RAD + FIST_RAD[finger, joint]) / 2
    expected = np.zeros(15)
    expected[place] = 0.5
    np.testing.assert_allclose(closed(hand(bent)), expected, atol=1e-9)
    assert NAMES[place] == f"{FINGERS[finger]}_{joint}"


def test_a_hand_whose_joints_lie_in_one_place_is_open_and_no_error() -> None:
    np.testing.assert_array_equal(closed(np.zeros((26, 7))), np.zeros(15))
