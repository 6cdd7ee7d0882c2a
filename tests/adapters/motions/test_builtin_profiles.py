"""Smooth ways, and the legs that follow."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.motions.builtin import legs
from adapters.motions.builtin.profiles import FPS, below, bump, rise, sway_under, times
from adapters.robots.g1 import joints, kinematics
from adapters.robots.g1.joints import LEGS
from station.errors import ConfigError


@pytest.mark.parametrize(("way", "end"), [(rise, 1.0), (bump, 0.0)])
def test_a_way_begins_and_ends_without_speed_or_acceleration(way, end: float) -> None:  # type: ignore[no-untyped-def]
    time_s = np.linspace(0.0, 3.0, 3001)
    values = way(time_s, 1.0, 2.0)
    speed = np.gradient(values, time_s)
    assert (values[:1000] == 0.0).all()
    np.testing.assert_allclose(values[2000:], end, atol=1e-12)
    assert values.max() == pytest.approx(1.0)
    assert np.abs(np.diff(speed)).max() < 0.03  # no jump: at most 30 per second squared, in steps of a millisecond


def test_the_weight_sways_as_a_pendulum_does_and_ends_where_it_stands() -> None:
    steps = np.repeat([0.0, 0.1, -0.1, 0.1, 0.0], 25)
    zmp = np.column_stack([np.zeros(400), np.pad(steps, (100, 175))])
    com = sway_under(zmp, 0.7)
    acceleration = (com[2:] - 2 * com[1:-1] + com[:-2]) * FPS**2
    np.testing.assert_allclose(acceleration, 9.81 / 0.7 * (com - zmp)[1:-1], atol=1e-3)
    assert np.abs(com[[0, -1]]).max() < 3e-3
    assert 0.01 < np.abs(com[:, 1]).max() < 0.1


def test_a_wish_gives_way_to_a_limit_smoothly_and_only_near_it() -> None:
    wish, limit = np.full(300, 0.78), np.full(300, 1.0)
    limit[140:160] = 0.7
    way = below(wish, limit, 0.2)
    assert (way <= limit + 1e-12).all()
    np.testing.assert_allclose(way[[0, 115, 185, 299]], 0.78, atol=1e-12)
    assert np.abs(np.diff(way, 2)).max() * FPS**2 < 10.0


def test_times_include_both_ends() -> None:
    time_s = times(2.5)
    assert (time_s[0], time_s[-1], len(time_s)) == (0.0, 2.5, 126)


def test_legs_find_the_joints_that_put_the_feet_where_they_were() -> None:
    rng = np.random.default_rng(5)
    q = np.zeros((200, 29))
    q[:, :12] = legs.STANDING_LEGS + rng.uniform(-0.25, 0.25, (200, 12))
    bend = rng.uniform(0.0, 1.2, (200, 2))
    for column, share in ((0, -0.5), (3, 1.0), (4, -0.5)):
        q[:, [column, column + 6]] += share * bend
    pelvis = np.tile([0.1, -0.2, 0.7], (200, 1))
    quats = np.tile([np.cos(0.1), 0.0, np.sin(0.1), 0.0], (200, 1))
    links = kinematics.forward(pelvis, quats, q)
    feet = [kinematics.INDEX[f"{side}_ankle_roll"] for side in legs.SIDES]
    found = legs.solve(pelvis, kinematics.matrix(quats), links.position[feet], links.rotation[feet])
    np.testing.assert_allclose(found, q[:, :12], atol=1e-4)
    assert len(LEGS) == found.shape[1]


def test_a_foot_out_of_reach_is_said_so() -> None:
    standing = np.zeros((3, 29))
    standing[:, :12] = legs.STANDING_LEGS
    pelvis, quats = np.zeros((3, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    links = kinematics.forward(pelvis, quats, standing)
    index = [kinematics.INDEX[f"{side}_ankle_roll"] for side in legs.SIDES]
    feet = links.position[index].copy()
    feet[1, 2, 2] -= 0.2
    with pytest.raises(ConfigError, match="frame 2: the right foot is out of the leg's reach by"):
        legs.solve(pelvis, kinematics.matrix(quats), feet, links.rotation[index])


@pytest.mark.parametrize("knee", [0.2, 0.6])
def test_the_highest_pelvis_is_where_the_knee_is_as_straight_as_allowed(knee: float) -> None:
    standing = np.zeros((1, 29))
    standing[0, [0, 3, 4, 6, 9, 10]] = [-knee / 2, knee, -knee / 2] * 2
    links = kinematics.forward(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), standing)
    feet = links.position[[kinematics.INDEX[f"{side}_ankle_roll"] for side in legs.SIDES]]
    height = legs.highest(np.eye(3)[None], np.zeros((1, 2)), feet, knee)
    assert height[0] == pytest.approx(0.0, abs=5e-3)
    assert joints.upper(("left_knee",))[0] > knee
