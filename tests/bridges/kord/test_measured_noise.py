"""What sensors add: a joint that stands has a measured speed, in an exact and repeatable course on a virtual clock."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from station_kord import BadOption, KordBridge, SimOptions

from tests.bridges.kord.arms import LIMITS, ONE_JOINT, arm

NOISE_RADPS = 0.0005
"""Below what counts as motion (0.001 rad/s): a joint that stands is not taken for one that moves."""
SPEED_RADPS = 0.5


def measured(bridge: KordBridge) -> NDArray[Any]:
    return bridge.trace()["qd"]


def truth(bridge: KordBridge) -> NDArray[Any]:
    assert bridge.simulator is not None
    return bridge.simulator.trace(bridge.get_state().tick)["qd"]


def test_the_noise_is_in_what_is_measured_of_every_joint_and_not_in_the_arm() -> None:
    with arm(speed_noise_radps=NOISE_RADPS) as bridge:
        state = bridge.step(500)
        assert not state.is_moving
        assert np.abs(measured(bridge)).max() <= NOISE_RADPS
        assert np.abs(measured(bridge)).max(axis=0).min() > 0.9 * NOISE_RADPS
        assert np.abs(measured(bridge).mean(axis=0)).max() < 0.15 * NOISE_RADPS
        assert not truth(bridge).any()


def test_the_noise_is_the_same_in_every_run_and_another_with_another_seed() -> None:
    courses = []
    for seed in (1, 1, 2):
        with arm(speed_noise_radps=NOISE_RADPS, noise_seed=seed) as bridge:
            bridge.move_j(0.2 * ONE_JOINT, speed_radps=SPEED_RADPS)
            bridge.step(200)
            courses.append(measured(bridge))
    assert np.array_equal(courses[0], courses[1])
    assert not np.array_equal(courses[0], courses[2])


@pytest.mark.parametrize(
    "wrong", [{"speed_noise_radps": -1.0}, {"speed_noise_radps": np.nan}, {"noise_seed": -1}], ids=str
)
def test_a_noise_that_cannot_be_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadOption, match="0 or more"):
        SimOptions(**wrong)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("end", ["hold", "disengage"])
@pytest.mark.parametrize("kind", ["joints", "line"])
def test_a_move_is_ended_before_its_goal_though_joints_that_stand_have_a_measured_speed(
    kind: str, end: str, seed: int
) -> None:
    start = (0.3, 0.5, 0.1, 1.0, 0.2, 0.8, 0.1)
    with arm(speed_noise_radps=NOISE_RADPS, noise_seed=seed, q_start=start) as bridge:
        if kind == "joints":  # joints 2 to 7 are where they are to be all the time
            bridge.move_j(np.array(start) + 0.5 * ONE_JOINT, speed_radps=SPEED_RADPS)
        else:
            bridge.move_l(bridge.get_state().tcp_pose + np.array([0.1, -0.1, 0.1, 0, 0, 0]), speed_mps=0.1)
        before = bridge.step(120)
        assert before.is_moving
        getattr(bridge, end)()
        state = bridge.step(60)
        assert (state.move_sends, state.is_moving, state.mode, state.events) == (2, False, "idle", ())
        assert np.all(np.abs(state.q - before.q) <= (np.abs(before.qd) + NOISE_RADPS) * 0.1 + 1e-3)
        assert not truth(bridge)[-20:].any()


@pytest.mark.parametrize("ticks", [200, 235, 245, 248, 249, 250, 251])
def test_a_move_that_is_all_but_over_does_not_go_beyond_its_goal_for_a_measured_speed(ticks: int) -> None:
    q_max = (0.5, *LIMITS.q_max[1:])
    with arm(speed_noise_radps=NOISE_RADPS, q_max=q_max) as bridge:
        bridge.move_j(0.5 * ONE_JOINT, speed_radps=SPEED_RADPS)
        bridge.step(ticks)
        bridge.hold()
        state = bridge.step(100)
        assert (state.is_moving, state.events) == (False, ())
        assert bridge.trace()["q"][:, 0].max() <= 0.5 + 1e-9
