"""Walking by sticks: whatever they do, feet that carry stand still, nothing jumps, and the robot keeps its feet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.motions.builtin.body import STANDING_HEIGHT_M, STANDING_Q
from adapters.retarget.steps import SWING_S
from adapters.retarget.walking import (
    ACCELERATION,
    FASTEST,
    FASTEST_BACK,
    LOWEST_M,
    LOWEST_WALK_M,
    VelocityCommand,
    Walker,
)
from adapters.robots.g1 import joints as g1
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from benchmarks.walking import velocity_reached
from station import rotations
from station.bus import codec
from station.control.command_validator import CommandSample
from station.control.rig import RigConfig, build
from station.protocols import Floats, Reference
from tests.examples import some

TICK_S = 0.02
FEET = ("left_ankle_roll", "right_ankle_roll")


def walked(wishes: list[tuple[float, VelocityCommand]], tick_s: float = TICK_S) -> tuple[Walker, list[Reference]]:
    """Follow wishes, each for a time [s]."""
    walker = Walker()
    return walker, [walker.step(tick_s, wish) for seconds, wish in wishes for _ in range(round(seconds / tick_s))]


def soles(references: list[Reference]) -> Floats:
    """Where the two feet are, shape (n, 2, 3) [m]."""
    poses = kinematics.forward(
        np.array([r.root_pos for r in references]),
        np.array([r.root_quat_wxyz for r in references]),
        np.array([r.q for r in references]),
    )
    return np.stack([poses.position[kinematics.INDEX[foot]] for foot in FEET], axis=1)


def any_wishes(seed: int, seconds: float) -> list[tuple[float, VelocityCommand]]:
    """What restless sticks ask for, more than the legs can included."""
    random = np.random.default_rng(seed)
    wishes, total_s = [(0.2, VelocityCommand())], 0.0
    while total_s < seconds:
        wishes.append(
            (
                float(random.uniform(0.04, 1.5)),
                VelocityCommand(*random.uniform([-1.5, -1.5, -1.5, 0.3], [1.5, 1.5, 1.5, 1.0])),
            )
        )
        total_s += wishes[-1][0]
    return wishes


def test_it_stands_as_the_policy_does_until_it_is_told_to_walk() -> None:
    walker, references = walked([(1.0, VelocityCommand())])
    assert references[-1].q == pytest.approx(STANDING_Q, abs=2e-3)
    assert references[-1].root_pos[2] == pytest.approx(STANDING_HEIGHT_M, abs=2e-3)
    assert np.abs(references[-1].root_lin_vel).max() < 1e-4
    assert walker.is_standing


@pytest.mark.parametrize(
    "velocity", some([(0.5, 0.0, 0.0), (-0.4, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, -0.3, -0.8), (0.7, 0.0, 0.8)])
)
def test_it_goes_as_fast_as_it_is_told_and_comes_to_a_stand(velocity: tuple[float, float, float]) -> None:
    walker, references = walked([(0.5, VelocityCommand()), (6.0, VelocityCommand(*velocity)), (5.0, VelocityCommand())])
    begin, end = references[200], references[300]
    headings = np.unwrap(rotations.roll_pitch_yaw(np.array([r.root_quat_wxyz for r in references]))[:, 2])
    assert headings[300] - headings[200] == pytest.approx(2.0 * velocity[2], abs=0.1)
    if velocity[2] == 0.0:
        assert (end.root_pos - begin.root_pos)[:2] == pytest.approx(2.0 * np.array(velocity[:2]), abs=0.08)
    assert walker.is_standing
    assert references[-1].q == pytest.approx(STANDING_Q, abs=5e-3)


def test_more_than_the_legs_can_is_cut_off() -> None:
    walker, _ = walked([(4.0, VelocityCommand(5.0, 5.0, 5.0))])
    assert walker.velocity == pytest.approx(FASTEST)
    walker, _ = walked([(4.0, VelocityCommand(0.0, -5.0, -5.0))])
    assert walker.velocity == pytest.approx(FASTEST * (0.0, -1.0, -1.0))
    walker, _ = walked([(4.0, VelocityCommand(-5.0))])
    assert walker.velocity[0] == pytest.approx(-FASTEST_BACK)


@pytest.mark.parametrize("turn", some([1.0, -1.0]))
def test_the_tracker_stays_in_a_fast_curve(turn: float) -> None:
    asked = (FASTEST[0], 0.0, turn * FASTEST[2])
    reached = velocity_reached(build(RigConfig(robot_options={"physics_dt_s": 0.002})), asked)
    assert np.hypot(*(reached - asked)[:2]) < 0.2, "without the way inward it is 0.26 m/s"
    assert abs(reached[1]) < 0.08


@pytest.mark.parametrize("seed", some(range(4)))
def test_whatever_the_sticks_do_nothing_jumps_and_no_joint_leaves_its_range(seed: int) -> None:
    walker = Walker()
    before, velocity = walker.step(TICK_S, VelocityCommand()), walker.velocity
    for seconds, wish in [*any_wishes(seed, seconds=10.0), (2.0, VelocityCommand())]:
        for _ in range(round(seconds / TICK_S)):
            now = walker.step(TICK_S, wish)
            assert (np.abs(walker.velocity - velocity) <= ACCELERATION * TICK_S + 1e-9).all()
            assert (np.abs(now.q - before.q) <= 0.7 * g1.velocity(G1_29) * TICK_S).all()
            assert np.abs(now.root_lin_vel - before.root_lin_vel).max() <= 15.0 * TICK_S
            assert (now.q >= g1.lower(G1_29)).all()
            assert (now.q <= g1.upper(G1_29)).all()
            before, velocity = now, walker.velocity
    assert walker.velocity == pytest.approx(np.zeros(3))


@pytest.mark.parametrize("seed", some(range(4)))
def test_feet_that_carry_stand_still(seed: int) -> None:
    _, references = walked(any_wishes(seed, seconds=6.0))
    feet = soles(references)
    on_floor = feet[..., 2] < feet[..., 2].min() + 2e-4
    carries = on_floor[1:] & on_floor[:-1]
    moved = np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1)
    assert carries.any(axis=1).all(), "one foot at least is on the floor"
    assert moved[carries].max() < 2e-3


def test_the_rate_of_ticks_does_not_change_where_it_goes() -> None:
    wishes = [
        (0.3, VelocityCommand()),
        (2.0, VelocityCommand(0.5, 0.1, 0.4)),
        (0.8, VelocityCommand(-0.3)),
        (3.0, VelocityCommand()),
    ]
    slow, fast = (walked(wishes, tick_s)[1][-1].root_pos for tick_s in (0.02, 0.005))
    assert fast == pytest.approx(slow, abs=0.03)


def test_it_squats_where_it_stands_and_less_where_it_walks() -> None:
    _, references = walked([(4.0, VelocityCommand(height=0.2))])
    assert references[-1].root_pos[2] == pytest.approx(LOWEST_M, abs=2e-3)
    walker, references = walked([(4.0, VelocityCommand(height=0.2)), (5.0, VelocityCommand(0.3, height=0.2))])
    assert walker.velocity[0] == pytest.approx(0.3)
    assert references[-1].root_pos[2] == pytest.approx(LOWEST_WALK_M, abs=0.01)


def test_letting_go_in_the_middle_of_a_step_puts_the_foot_down_first() -> None:
    _, references = walked(
        [
            (0.5, VelocityCommand()),
            (2.0, VelocityCommand(0.6)),
            (SWING_S / 2, VelocityCommand(0.6)),
            (4.0, VelocityCommand()),
        ]
    )
    feet = soles(references[-1:])[0]
    assert feet[0, 0] == pytest.approx(feet[1, 0], abs=1e-3)
    assert feet[:, 2] == pytest.approx(feet[0, 2], abs=1e-3)


def reversals(seed: int) -> Callable[[float], VelocityCommand]:
    """Sticks from end to end and back, at any time."""
    random = np.random.default_rng(seed)
    at_s, wishes = 1.0, [(0.0, VelocityCommand())]
    while at_s < 60.0:
        ends = np.sign(random.uniform(-1.0, 1.0, 3)) * FASTEST
        wishes.append((at_s, VelocityCommand(*ends.tolist(), height=float(random.uniform(0.5, 0.8)))))
        at_s += float(random.uniform(0.2, 3.0))
    return lambda now_s: [wish for begin_s, wish in wishes if begin_s <= now_s][-1]


def test_the_tracker_keeps_its_feet_under_sudden_reversals() -> None:
    rig = build(RigConfig(robot_options={"physics_dt_s": 0.002}))
    control, walker, wishes = rig.control(), Walker(), reversals(seed=4)
    for tick in range(round(12.0 / TICK_S)):
        now_s = tick * TICK_S
        command = np.clip(FORMAT.encode(walker.step(TICK_S, wishes(now_s)), G1_29), FORMAT.lower, FORMAT.upper)
        record = control.step(control.sense(), CommandSample(codec.json_vector(command), arrived_s=now_s), now_s)
        assert record.fall is None, f"it fell after {now_s:.1f} s: {record.fall}"
