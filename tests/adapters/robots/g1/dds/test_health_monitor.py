"""What the rate of a G1's states says before it is armed: which of robot and cable is to blame."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.robots.g1.dds import messages
from adapters.robots.g1.dds.health_monitor import HealthMonitor


def why_not_arm(every_ms: int, arrives: int, *least_rate_hz: float) -> str:
    """Return what is said after three seconds of states, of which all arrive but each so-manieth; 0 for all."""
    monitor = HealthMonitor("eno1, domain 0", *least_rate_hz)
    state = messages.new_state()
    state["quat_wxyz"][0, 0] = 1.0
    for number in range(3000 // every_ms):
        state["tick"] = 1000 + number * every_ms
        has_come = not arrives or number % arrives
        monitor.on_states(state if has_come else state[:0], 0, number * every_ms * 1e-3)
    return monitor.why_not_arm(3.0)


@pytest.mark.parametrize(("every_ms", "arrives", "words"), [
    (2, 20, "its states come at 475 Hz; expected 500: 5 % are lost on the way: is the cable good"),
    (2, 3, "33 % are lost on the way"),
    (2, 0, "the battery has said nothing for 5 s"),
])  # fmt: skip
def test_what_a_cable_loses_is_told_from_what_a_robot_does_not_send(every_ms, arrives, words):
    assert words in why_not_arm(every_ms, arrives)


def test_of_a_twin_on_a_busy_machine_fewer_states_are_expected():
    assert why_not_arm(2, 20, 450.0) == why_not_arm(2, 0)


def test_a_line_that_delivers_late_does_not_hide_what_it_loses():
    monitor = HealthMonitor("eno1, domain 0")
    state = messages.new_state()
    state["quat_wxyz"][0, 0] = 1.0
    for number in range(1600):  # of 3.2 s, within 3 s: what it held back comes faster
        state["tick"] = 1000 + number * 2
        monitor.on_states(state if number % 20 else state[:0], 0, number * 0.001875)
    assert "its states come at 506 Hz; expected 500: 5 % are lost on the way" in monitor.why_not_arm(3.0)


def test_after_a_silence_states_have_to_come_for_two_seconds_anew():
    monitor = HealthMonitor("eno1, domain 0")
    state = messages.new_state()
    state["quat_wxyz"][0, 0] = 1.0
    for milliseconds in [*range(0, 3000, 2), *range(6000, 9000, 2)]:
        state["tick"] = 1000 + milliseconds
        monitor.on_states(state, 0, milliseconds * 1e-3)
        if milliseconds == 7000:
            assert monitor.why_not_arm(7.0) == "its states have come for 1.0 s; expected 2 s of them"
    assert "battery" in monitor.why_not_arm(9.0)


def test_a_robot_whose_clock_goes_slow_sends_too_few():
    monitor = HealthMonitor("eno1, domain 0")
    state = messages.new_state()
    state["quat_wxyz"][0, 0] = 1.0
    for now_s in np.arange(0.0, 3.0, 0.00208):
        state["tick"] += 2
        monitor.on_states(state, 0, float(now_s))
    assert "expected 500: hardly any is lost on the way, the robot sends no more" in monitor.why_not_arm(3.0)
