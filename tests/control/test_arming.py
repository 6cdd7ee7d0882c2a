"""Disarmed sends nothing, arming ramps the stiffness up, armed sends all."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station import registry
from station.control.arming import RAMP_S, Arming, why_not_arm
from station.control.command_validator import CommandValidator
from station.control.gate import Gate
from station.protocols import JointTargets

TARGETS = JointTargets(np.ones(3), np.full(3, 100.0), np.full(3, 2.0))


def test_a_robot_that_starts_disarmed_gets_nothing_until_it_is_armed() -> None:
    arming = Arming(is_armed=False)
    assert arming.apply(TARGETS, 100.0) is None
    assert arming.state == "disarmed"


def test_arming_ramps_the_stiffness_up_over_two_seconds_with_full_damping() -> None:
    arming = Arming(is_armed=False)
    arming.arm(10.0)
    stiffness = []
    for tick in range(101):
        sent = arming.apply(TARGETS, 10.0 + tick * RAMP_S / 100)
        assert sent is not None
        np.testing.assert_array_equal(sent.kd, TARGETS.kd)
        stiffness.append(float(sent.kp[0]))
    np.testing.assert_allclose(stiffness, np.linspace(0, 100, 101), atol=1e-9)
    assert arming.state == "armed"


def test_arming_again_does_not_begin_the_ramp_anew() -> None:
    arming = Arming(is_armed=False)
    arming.arm(0.0)
    for tick in range(1, 76):
        if tick == 50:
            arming.arm(tick * 0.02)
        sent = arming.apply(TARGETS, tick * 0.02)
    assert sent is not None
    np.testing.assert_allclose(sent.kp, 75.0)


@pytest.mark.parametrize("odd_s", [1e9, -1e9, math.nan, math.inf])
def test_no_clock_however_odd_makes_a_robot_stiff_at_once(odd_s: float) -> None:
    arming = Arming(is_armed=False)
    arming.arm(5.0)
    sent = [arming.apply(TARGETS, now_s) for now_s in (5.0, 5.02, odd_s, 5.04, 5.06)]
    stiffness = [targets.kp[0] for targets in sent if targets is not None]
    assert np.diff(stiffness).min() >= 0.0
    assert np.diff(stiffness).max() <= 100.0 * 0.1 / RAMP_S + 1e-9


def test_disarming_works_at_once_and_restart_returns_to_the_state_of_the_start() -> None:
    arming = Arming(is_armed=True)
    assert arming.apply(TARGETS, 0.0) is TARGETS
    arming.disarm()
    assert arming.apply(TARGETS, 0.1) is None
    arming.restart()
    assert arming.apply(TARGETS, 0.2) is TARGETS


def test_under_a_latched_stop_a_robot_is_not_armed_though_no_command_comes() -> None:
    command_format = registry.find("command", "twist2")
    gate, validator = Gate(command_format.default), CommandValidator(command_format)
    assert why_not_arm(gate, validator, 0.0) == ""
    gate.stop("by hand")
    assert why_not_arm(gate, validator, 0.0).startswith("the emergency stop is latched (by hand); release it first")
