"""What holds for every motion that is made here, measured by kinematics alone."""

from __future__ import annotations

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.motions.raw import RawMotion
from adapters.robots.g1 import joints, kinematics
from adapters.robots.g1.joints import G1_29
from station import rotations

FPS = 50.0
STANDING_Q = FORMAT.default[6:]
ON_THE_FLOOR_M = 1e-3
SLIDE_M, SLIDE_RAD = 0.005, np.radians(1.0)


def assert_within_ranges(motion: RawMotion) -> None:
    lower, upper = joints.lower(G1_29), joints.upper(G1_29)
    free = 0.02 * (upper - lower) - 1e-9
    beyond = [
        G1_29[column] for column in np.flatnonzero(((motion.q < lower + free) | (motion.q > upper - free)).any(0))
    ]
    assert beyond == []


def assert_stands_at_rest_at_both_ends(motion: RawMotion) -> None:
    for end, next_to_it in ((0, 1), (-1, -2)):
        np.testing.assert_allclose(motion.q[end], STANDING_Q, atol=1e-6)
        assert rotations.tilt(motion.root_quat_wxyz[end]) < 1e-6
        for frames in (motion.q, motion.root_pos, motion.root_quat_wxyz):
            np.testing.assert_allclose(frames[next_to_it], frames[end], atol=2e-5)  # 1 mm/s, 1 mrad/s


def assert_smooth(motion: RawMotion, *, acceleration: float, speed_used: float = 0.5) -> None:
    """Joints use a part of their speed at most, and change it no faster than given [rad/s^2]; so does the root."""
    speed = np.diff(motion.q, axis=0) * FPS
    greatest = np.array([joint.velocity_rad_s for joint in joints.JOINTS])
    assert (np.abs(speed).max(axis=0) <= speed_used * greatest).all()
    assert np.abs(np.diff(speed, axis=0)).max() * FPS <= acceleration
    root_speed = np.diff(motion.root_pos, axis=0) * FPS
    assert np.linalg.norm(root_speed, axis=1).max() < 1.5
    assert np.abs(np.diff(root_speed, axis=0)).max() * FPS < 10.0
    turned = rotations.multiply(rotations.inverse(motion.root_quat_wxyz[:-1]), motion.root_quat_wxyz[1:])
    turn_rate = rotations.rotation_vector(turned) * FPS
    assert np.abs(turn_rate).max() < 2.5
    assert np.abs(np.diff(turn_rate, axis=0)).max() * FPS < 20.0


def assert_feet_carry(motion: RawMotion) -> None:
    """Soles are level; in every frame one is on the floor, none below it; and while on it, none slides or turns."""
    links = kinematics.forward(motion.root_pos, motion.root_quat_wxyz, motion.q)
    heights = []
    for side in ("left", "right"):
        soles = links.points(f"{side}_ankle_roll", kinematics.SOLE_POINTS)
        assert np.ptp(soles[..., 2], axis=1).max() < 1e-4
        heights.append(soles[..., 2].min(axis=1))
        _assert_does_not_slide(soles, heights[-1] < ON_THE_FLOOR_M)
    lowest = np.minimum(*heights)
    assert np.abs(lowest).max() < 1e-4


def _assert_does_not_slide(soles: np.ndarray, is_down: np.ndarray) -> None:
    forward = soles[:, 2, :2] - soles[:, 0, :2]
    heading = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    edges = np.flatnonzero(np.diff(is_down)) + 1
    for frames in np.split(np.arange(len(is_down)), edges):
        if is_down[frames[0]]:
            assert np.ptp(soles[frames].mean(axis=1)[:, :2], axis=0).max() <= SLIDE_M
            assert np.ptp(heading[frames]) <= SLIDE_RAD
