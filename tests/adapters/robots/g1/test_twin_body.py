"""The body of a robot's twin: what its gantry's rope carries."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from adapters.robots.g1.twin.body import FALLEN_M, JOINTS, TwinBody
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.legged.unitree import G1
from station import assets

DEEPEST_SQUAT_M = 0.4
"""Height of the pelvis in TWIST2's walk 006, which picks something up."""


@pytest.fixture(scope="module")
def standing() -> TwinBody:
    body = TwinBody(assets.resolve(G1.mjcf))
    body.held.q, body.held.kp, body.held.kd = np.array(G1.start_q), np.full(JOINTS, 300.0), np.full(JOINTS, 5.0)
    body.change(G1Faults(gantry="slack"))
    body.step(7000)
    assert body.height_m > 0.7
    return body


def fall(body: TwinBody, until_m: float) -> list[float]:
    """Let it go limp; return its heights, every 10 ms, until it is so low or for three seconds."""
    body.held.kp, body.held.kd = np.zeros(JOINTS), np.zeros(JOINTS)
    heights = [body.height_m]
    while heights[-1] > until_m and len(heights) < 300:
        body.step(10)
        heights.append(body.height_m)
    return heights


def test_a_slack_rope_carries_nothing_of_a_squat_and_catches_who_falls(standing: TwinBody) -> None:
    roped, free = copy.deepcopy(standing), copy.deepcopy(standing)
    free.change(G1Faults(gantry="off"))
    assert fall(roped, DEEPEST_SQUAT_M) == fall(free, DEEPEST_SQUAT_M)
    assert roped.falls == free.falls == 0
    caught, lies = fall(roped, 0.0)[-1], fall(free, 0.0)[-1]
    assert lies < 0.2 < caught < FALLEN_M
    assert roped.falls == free.falls == 1
