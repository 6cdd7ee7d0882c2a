"""A twist moves what the mode says, along the axes of the pelvis, and stops with the hand."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.drivers.jog import PALM_MPS, JogDriver
from station.operator.deadman import Snapshot
from station.operator.sample import OperatorSample

from .operators import TICK_S

pytest.importorskip("mink")


def engaged() -> tuple[JogDriver, Snapshot]:
    driver = JogDriver()
    snapshot = Snapshot(np.zeros(6), driver.target)
    driver.step(OperatorSample(twist=np.zeros(6)), snapshot, TICK_S)
    return driver, snapshot


def twisted(*axes: float) -> OperatorSample:
    return OperatorSample(twist=np.array([*axes, *[0.0] * (6 - len(axes))]))


def test_up_is_up_and_letting_the_knob_go_stops_it() -> None:
    driver, snapshot = engaged()
    start = driver.target["right"].position
    for _ in range(50):
        driver.step(twisted(0.0, 0.0, 1.0), snapshot, TICK_S)
    raised = driver.target["right"].position
    assert raised - start == pytest.approx([0.0, 0.0, 0.5 * PALM_MPS], abs=0.02)
    for _ in range(100):
        driver.step(twisted(), snapshot, TICK_S)
    assert driver.target["right"].position == pytest.approx(raised, abs=0.02)


def test_pushing_against_the_end_and_turning_back_acts_at_once() -> None:
    driver, snapshot = engaged()
    for _ in range(300):
        driver.step(twisted(1.0), snapshot, TICK_S)
    far = driver.target["right"].position[0]
    for _ in range(60):
        driver.step(twisted(-1.0), snapshot, TICK_S)
    assert driver.target["right"].position[0] < far - 0.03


def test_the_modes_go_round_from_palm_to_palm_to_walking() -> None:
    driver, snapshot = engaged()
    assert [driver.mode, driver.next_mode(), driver.next_mode(), driver.next_mode()] == [
        "right",
        "walk",
        "left",
        "right",
    ]
    driver.next_mode()
    for _ in range(200):
        command = driver.step(twisted(1.0), snapshot, TICK_S)
    assert command[0] > 0.3
    driver.next_mode()
    left = driver.target["left"].position
    for _ in range(50):
        driver.step(twisted(0.0, 0.0, 1.0), snapshot, TICK_S)
    assert driver.target["left"].position[2] > left[2] + 0.08
