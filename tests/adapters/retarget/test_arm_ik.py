"""Arms by the poses of palms: no joint beyond its range or its speed, no jump, nothing moves that nobody moved."""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import pytest

from adapters.retarget.arm_ik import ARMS, FASTEST_RAD_S, SIDES, ArmIk, within_reach
from adapters.robots.g1 import joints as g1
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.errors import StationError
from station.operator import deltas
from station.operator.sample import Pose, Side
from station.protocols import Floats

pytest.importorskip("mink")

TICK_S = 0.01
FORWARD = np.array([-1.0, 0.2, 0.0, 0.6, 0.0, 0.0, 0.0, -1.0, -0.2, 0.0, 0.6, 0.0, 0.0, 0.0])
PALM = np.array([0.08, 0.0, 0.0])  # in the frame of the last link of a wrist


@pytest.fixture(scope="module")
def arms() -> ArmIk:
    return ArmIk()


def palms_of(q: Floats) -> dict[Side, Floats]:
    """Where the palms are according to the kinematics in numpy [m]."""
    whole = np.zeros((1, len(G1_29)))
    whole[0, 15:] = q
    poses = kinematics.forward(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), whole)
    return {side: poses.points(f"{side}_wrist_yaw", PALM[None])[0, 0] for side in SIDES}


def wave(start: Mapping[Side, Pose], time_s: float, size: float) -> dict[Side, Pose]:
    """Hands that begin where palms are and swing about."""
    size *= min(time_s, 1.0)
    goals: dict[Side, Pose] = {}
    for side, mirror in zip(SIDES, (1.0, -1.0), strict=True):
        way = np.array([np.sin(2.0 * time_s) - 0.5, mirror * np.sin(3.0 * time_s), np.sin(1.3 * time_s)])
        turn = rotations.from_rotation_vector(3.0 * size * np.array([np.sin(time_s), np.sin(1.7 * time_s), 0.5]))
        goals[side] = Pose(start[side].position + size * way, rotations.multiply(turn, start[side].quat_wxyz))
    return goals


def smallest_gap(arms: ArmIk) -> float:
    """Distance between the nearest two shapes that must not touch [m]."""
    configuration, limit = arms._configuration, arms._limits[2]
    pairs = limit.geom_id_pairs
    return min(mujoco.mj_geomDistance(configuration.model, configuration.data, *pair, 0.2, None) for pair in pairs)


def test_the_palms_are_where_the_kinematics_have_them(arms: ArmIk) -> None:
    arms.reset(FORWARD)
    for side, position in palms_of(FORWARD).items():
        assert arms.palms[side].position == pytest.approx(position, abs=1e-5)


def test_goals_that_are_where_the_palms_are_move_nothing_to_speak_of(arms: ArmIk) -> None:
    for q in (arms.q, FORWARD):
        arms.reset(q)
        start = arms.palms
        first = arms.step(start, TICK_S)
        assert np.abs(first - q).max() < 1e-4
        for _ in range(300):
            arms.step(start, TICK_S)
        for side in SIDES:
            assert arms.palms[side].position == pytest.approx(start[side].position, abs=5e-3)


def test_palms_follow_goals_within_reach(arms: ArmIk) -> None:
    arms.reset(FORWARD)
    start = arms.palms
    far, turned = [], []
    for tick in range(600):
        goals = wave(start, tick * TICK_S, size=0.05)
        arms.step(goals, TICK_S)
        far += [np.linalg.norm(arms.palms[side].position - goals[side].position) for side in SIDES]
        turned += [deltas.angle_between(arms.palms[side].quat_wxyz, goals[side].quat_wxyz) for side in SIDES]
    assert np.mean(far) < 0.006
    assert np.mean(turned) < 0.03


@pytest.mark.parametrize("size", [0.15, 1.0])
def test_goals_out_of_reach_break_no_limit_and_touch_nothing(arms: ArmIk, size: float) -> None:
    arms.reset(FORWARD)
    start, before = arms.palms, arms.q
    for tick in range(800):
        q = arms.step(wave(start, tick * TICK_S, size), TICK_S)
        assert (np.abs(q - before) <= FASTEST_RAD_S * TICK_S + 1e-9).all()
        assert (q >= g1.lower(ARMS)).all()
        assert (q <= g1.upper(ARMS)).all()
        assert smallest_gap(arms) > 0.0
        before = q


@pytest.mark.parametrize("seed", range(3))
def test_goals_that_leap_about_break_no_limit(arms: ArmIk, seed: int) -> None:
    random = np.random.default_rng(seed)
    arms.reset(random.uniform(g1.lower(ARMS), g1.upper(ARMS)))
    before = arms.q
    for _ in range(40):
        goals = {side: Pose(random.uniform(-1, 1, 3), rotations.normalized(random.normal(size=4))) for side in SIDES}
        for _ in range(int(random.integers(1, 20))):
            dt_s = float(random.uniform(0.002, 0.03))
            q = arms.step(goals, dt_s)
            assert (np.abs(q - before) <= FASTEST_RAD_S * dt_s + 1e-9).all()
            assert (q >= g1.lower(ARMS)).all()
            assert (q <= g1.upper(ARMS)).all()
            before = q


def test_a_palm_without_a_goal_stays(arms: ArmIk) -> None:
    arms.reset(FORWARD)
    start = arms.palms
    for tick in range(200):
        arms.step({"left": wave(start, tick * TICK_S, 0.05)["left"]}, TICK_S)
    assert arms.palms["right"].position == pytest.approx(start["right"].position, abs=0.01)


def test_time_that_stands_still_moves_nothing(arms: ArmIk) -> None:
    arms.reset(FORWARD)
    assert arms.step(wave(arms.palms, 1.0, 0.1), 0.0) == pytest.approx(FORWARD, abs=0.0)


def test_the_waist_helps_where_it_may() -> None:
    goals = {
        side: Pose(pose.position + np.array([0.35, 0.0, 0.1]), pose.quat_wxyz) for side, pose in ArmIk().palms.items()
    }
    missing = []
    for arms in (ArmIk(), ArmIk(waist=True)):
        for _ in range(300):
            arms.step(goals, TICK_S)
        missing.append(sum(float(np.linalg.norm(arms.palms[s].position - goals[s].position)) for s in SIDES))
    assert missing[1] < missing[0] - 0.02


def test_a_goal_in_reach_is_left_alone_and_one_beyond_comes_nearer_on_its_line() -> None:
    shoulder, quat = np.array([0.0, 0.1, 0.3]), np.array([1.0, 0.0, 0.0, 0.0])
    near = Pose(shoulder + np.array([0.3, 0.0, 0.0]), quat)
    assert within_reach(near, shoulder) is near
    far = within_reach(Pose(shoulder + np.array([0.6, 0.8, 0.0]), quat), shoulder)
    assert (far.position - shoulder) / np.linalg.norm(far.position - shoulder) == pytest.approx([0.6, 0.8, 0.0])
    assert 0.4 < np.linalg.norm(far.position - shoulder) < 0.45


def test_without_mink_one_line_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any, **named: Any) -> Any:
        if name == "mink":
            raise ImportError("No module named 'mink'")
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(StationError, match=r"pip install 'teleop-station\[retarget\]'"):
        ArmIk()
