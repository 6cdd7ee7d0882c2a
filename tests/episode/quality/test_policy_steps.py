"""Policy steps are measured by what a robot says that its keys hold, whatever that is."""

from __future__ import annotations

import numpy as np
import pytest

from station.bus import codec, keys
from station.contract import Contract, Element
from station.episode.quality.findings import StepQuality
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


def test_what_a_policy_does_not_listen_to_is_not_what_it_is_measured_by() -> None:
    """Of a robot with two policies each is compared with its own part of the command."""
    asked = ("vx", "vy", "wz", "root_height", "knee_pos")
    held = {
        keys.robot_state(ROBOT): ("knee_pos", "knee_vel", *QUAT),
        keys.sim_qpos(ROBOT): ("root_x", "root_y", "root_z", *QUAT, "knee_pos"),
        keys.command_used(ROBOT): asked,
        keys.command_used(f"{ROBOT}_walk"): asked[:3],
        keys.command_used(f"{ROBOT}_track"): asked[3:],
    }
    contracts = {key: contract(key, each) for key, each in held.items()}

    def measured(listens: dict[str, str]) -> StepQuality:
        meter = StepMeter(ROBOT, 0, contracts.get, period_s=0.02, listens=listens)
        for number in range(1, 401):
            walks = number <= 200
            values = {
                keys.robot_state(ROBOT): codec.f64([0.5 if walks else 0.1, 0.0, 1.0, 0.0, 0.0, 0.0]),
                keys.sim_qpos(ROBOT): codec.f64([0.01 * min(number, 200), 0.0, 0.7, 1.0, 0.0, 0.0, 0.0, 0.0]),
                keys.command_used(ROBOT): codec.f64([0.5, 0.0, 0.0, 0.6, 0.0]),
                keys.command_gate(ROBOT): b'{"state": "tracking", "policy": "%s"}' % (b"walks" if walks else b"tracks"),
            }
            meter.feed(Step("a", number, number, number * 20_000_000, values, {}))
        return meter.result()

    found = measured({"walks": "walk", "tracks": "track"})
    assert found.mean_joint_error_rad == pytest.approx(0.1), "while it walks no joint is commanded"
    assert found.mean_root_height_error_m == pytest.approx(0.1)
    assert found.velocity is not None
    assert found.velocity.error[0] == pytest.approx(0.0, abs=1e-6), "while it tracks no velocity is"
    of_all = measured({})
    assert of_all.mean_joint_error_rad == pytest.approx(0.3)
