"""The neck turns as the operator's head does on the chest, in stock TWIST2's signs, gently, and stays when let go."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adapters.commands.hands import LIMIT_RAD, RATE_RAD_S
from adapters.drivers.body import BodyDriver
from adapters.drivers.hands import HandsDriver, HandsOptions
from adapters.drivers.neck import SCALE, Neck
from adapters.robots.g1 import twist_keys
from station import rotations
from station.bus.joints import SMPL_24
from station.operator.deadman import Snapshot
from station.operator.sample import Body, Pose
from station.protocols import Floats

from .operators import TICK_S, Shadow, body, hands

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def turned(*, left: float = 0.0, down: float = 0.0, tilt: float = 0.0) -> Floats:
    """A head that turns left, then nods, then tilts, in a frame x forward, y left, z up."""
    about = (rotations.from_rotation_vector(axis) for axis in ([0.0, 0.0, left], [0.0, down, 0.0], [tilt, 0.0, 0.0]))
    yaw, pitch, roll = about
    return rotations.multiply(yaw, rotations.multiply(pitch, roll))


def looked(neck: Neck, head: Floats, chest: Floats = LEVEL, seconds: float = 2.0) -> Floats:
    for _ in range(round(seconds / TICK_S)):
        neck.follow(chest, head, TICK_S)
    return neck.command[twist_keys.action_neck()]


@pytest.mark.parametrize(
    ("head", "command"),
    [
        (turned(left=0.4), [-0.4 * SCALE, 0.0]),
        (turned(down=0.4), [0.0, -0.4 * SCALE]),
        (turned(tilt=0.4), [0.0, 0.0]),
        (turned(left=0.3, down=0.4, tilt=0.5), [-0.3 * SCALE, -0.4 * SCALE]),
        (turned(left=2.0), [-LIMIT_RAD, 0.0]),
    ],
)
def test_yaw_is_to_the_right_and_pitch_upwards_as_in_stock(head: Floats, command: list[float]) -> None:
    assert looked(Neck(), head) == pytest.approx(command)


def test_it_is_what_stock_computes_from_the_frames_of_the_headset() -> None:
    """Stock: Euler angles x y z of the head on the chest, axes x right, y up, z back; yaw is -y, pitch is x."""
    yaw, pitch = 0.3, 0.2
    to_right, to_up = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    turn, nod = rotations.from_rotation_vector(to_up * yaw), rotations.from_rotation_vector(to_right * pitch)
    chest = turned(left=1.0, down=0.2)
    head = rotations.multiply(chest, rotations.multiply(turn, nod))
    assert looked(Neck(), head, chest) == pytest.approx([-SCALE * yaw, SCALE * pitch])


def test_it_is_no_faster_than_its_rate_and_a_scale_of_zero_keeps_it_still() -> None:
    neck, before = Neck(), np.zeros(2)
    for _ in range(100):
        now = looked(neck, turned(left=0.8, down=-0.5), seconds=TICK_S)
        assert np.abs(now - before).max() <= RATE_RAD_S * TICK_S + 1e-12
        before = now
    assert not looked(Neck(0.0), turned(left=0.8)).any()


def test_a_headset_turns_the_neck_while_hands_drive_and_it_stays_when_they_let_go() -> None:
    pytest.importorskip("mink")
    facing = replace(hands(0.0), controls={}, head=Pose(np.zeros(3), turned(left=1.0)))
    looking = replace(facing, head=Pose(np.zeros(3), turned(left=0.7)))
    driver = HandsDriver(HandsOptions(heading="head"))
    snapshot = Snapshot(driver.inspect(facing).input, driver.target)
    for _ in range(100):
        driver.step(looking, snapshot, TICK_S)
    held = driver.auxiliary[twist_keys.action_neck()]
    assert held == pytest.approx([0.3 * SCALE, 0.0])
    driver.step(facing, None, TICK_S)
    assert driver.auxiliary[twist_keys.action_neck()] == pytest.approx(held)


def test_a_tracked_head_turns_the_neck_while_the_body_drives() -> None:
    driver = BodyDriver(Shadow())
    first = body(0.0).body
    assert first is not None
    quats = first.quats_wxyz.copy()
    quats[SMPL_24.index("head")] = turned(down=math.radians(20.0))
    snapshot = Snapshot(first, driver.target)
    for tick in range(100):
        driver.step(replace(body(tick * TICK_S), body=Body(first.positions, quats)), snapshot, TICK_S)
    assert driver.auxiliary[twist_keys.action_neck()] == pytest.approx([0.0, -math.radians(30.0)])


def test_a_scale_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="neck_scale is 4; expected 0 to 3"):
        HandsOptions(neck_scale=4.0)
