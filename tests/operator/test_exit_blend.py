"""The way out of driving, with given periods."""

from __future__ import annotations

import numpy as np

from adapters.commands.arm import arm_command
from adapters.robots import arm_limits
from adapters.robots.g1 import twist_keys
from station import registry
from station.operator.driving import COMES_TO_REST_S, ExitBlend

FORMAT = registry.find("command", "twist2")
DT_S = 0.02


def test_what_moves_comes_to_rest_before_the_blend_begins() -> None:
    leaving, moving = ExitBlend(FORMAT, 2.0), FORMAT.default + 0.3
    for _ in range(50):
        assert leaving.step(moving, DT_S, is_still=False) is moving
    assert not leaving.is_done


def test_blend_ends_at_the_default_without_a_step() -> None:
    leaving, held = ExitBlend(FORMAT, 2.0), FORMAT.default + 0.3
    held[list(FORMAT.velocities)] = 0.0
    sent = [held]
    while not leaving.is_done:
        sent.append(leaving.step(held, DT_S, is_still=True))
    assert np.abs(sent[-1] - FORMAT.default).max() < 1e-12
    assert np.abs(np.diff(sent, axis=0)).max() < 0.01


def test_a_walk_that_has_to_be_left_stands_after_200_ms_while_its_pose_is_blended() -> None:
    leaving, walking = ExitBlend(FORMAT, 2.0), FORMAT.default + 0.3
    sent = [leaving.step(walking, DT_S, is_still=True) for _ in range(100)]
    velocities, poses = list(FORMAT.velocities), [i for i in range(len(FORMAT.default)) if i not in FORMAT.velocities]
    assert (np.diff(sent[:10], axis=0)[:, velocities] < 0.0).all()
    assert np.abs(np.array(sent[9:])[:, velocities]).max() < 1e-12
    assert np.abs(sent[9] - FORMAT.default)[poses].min() > 0.29
    assert np.abs(sent[-1] - FORMAT.default).max() < 1e-12


def test_what_never_rests_is_not_waited_for_for_ever() -> None:
    leaving, moving = ExitBlend(FORMAT, 2.0), FORMAT.default + 0.3
    for _ in range(round((COMES_TO_REST_S + 2.0) / DT_S) + 2):
        leaving.step(moving, DT_S, is_still=False)
    assert leaving.is_done


def test_the_neck_goes_along_to_its_default_and_hands_keep_what_they_hold() -> None:
    leaving, held = ExitBlend(FORMAT, 2.0), FORMAT.default + 0.3
    beside = {twist_keys.action_neck(): np.array([0.6, -0.4]), twist_keys.action_hand("left"): np.ones(7)}
    necks = []
    while not leaving.is_done:
        leaving.step(held, DT_S, is_still=True)
        found = leaving.auxiliary(beside)
        necks.append(found[twist_keys.action_neck()])
        assert found[twist_keys.action_hand("left")] is beside[twist_keys.action_hand("left")]
    assert np.abs(necks[-1]).max() < 1e-12
    assert np.abs(np.diff([beside[twist_keys.action_neck()], *necks], axis=0)).max() < 0.02


def test_a_robot_that_stays_where_it_is_is_left_there_at_once() -> None:
    arm = arm_command("kassow", arm_limits.load("kassow", "kr810"))
    leaving, where = ExitBlend(arm, 30.0), arm.default + 0.3
    assert not leaving.is_done
    assert leaving.step(where, DT_S, is_still=True) is where
    assert leaving.is_done
