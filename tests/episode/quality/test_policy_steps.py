"""Policy steps are measured by what a robot says that its keys hold, whatever that is."""

from __future__ import annotations

import numpy as np
import pytest

from station.bus import codec, keys
from station.contract import Contract, Element
from station.episode.quality.policy_steps import StepMeter
from station.episode.reading.steps import Step

ROBOT = "stool"
QUAT = ("root_quat_w", "root_quat_x", "root_quat_y", "root_quat_z")
STATES = {
    "orientation": (QUAT, 1),
    "no orientation": (("knee_pos", "knee_vel"), 0),
    "a part of one": (QUAT[:3], 0),
    "one in another order": (QUAT[::-1], 0),
    "one that is torn apart": ((QUAT[0], "tick", *QUAT[1:]), 0),
}


def contract(key: str, names: tuple[str, ...]) -> Contract:
    elements = tuple(Element(name, "") for name in names)
    return Contract(key=key, family="test", role="state", codec="f64", elements=elements)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("truth", [("root_z", *QUAT), ("height",)])
def test_of_a_state_without_an_orientation_no_fall_is_told(state: str, truth: tuple[str, ...]) -> None:
    names, told = STATES[state]
    held = {
        keys.robot_state(ROBOT): names,
        keys.sim_qpos(ROBOT): truth,
        keys.command_used(ROBOT): ("knee_pos", "root_height"),
    }
    contracts = {key: contract(key, each) for key, each in held.items()}
    meter = StepMeter(ROBOT, 0, contracts.get)
    for number in range(1, 200):
        lying = {"root_quat_w": np.sqrt(0.5), "root_quat_x": np.sqrt(0.5)}
        values = {key: codec.f64([lying.get(name, 0.0) for name in each]) for key, each in held.items()}
        values[keys.command_gate(ROBOT)] = b'{"state": "tracking"}'
        meter.feed(Step("a", number, number, number * 20_000_000, values, {}))
    assert meter.result().steps == 199
    assert len(meter.falls()) == max(told, "root_z" in truth)
