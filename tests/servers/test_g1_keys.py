"""What a G1 server writes: its stated configuration, and every key of a tick as its contract says."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station import assets
from station.bus import codec, contracts, keys
from station.bus.address import BusAddress
from station.control.rig import checkpoint_of
from tests.servers.g1_station import LIGHT, ROBOT, G1Process, logged, ticks
from tests.waiting import wait_until

_STATE_KEYS = [
    twist_keys.state_body(ROBOT), twist_keys.state_hand("left"), twist_keys.state_hand("right"),
    twist_keys.state_neck(), twist_keys.T_STATE,
    keys.robot_state(ROBOT), keys.sim_qpos(ROBOT),
]  # fmt: skip
_RESULT_KEYS = [
    keys.policy_obs(ROBOT), keys.policy_action(ROBOT), keys.target(ROBOT), keys.command_gate(ROBOT),
    keys.command_used(ROBOT), keys.policy_timing(ROBOT),
]  # fmt: skip


@pytest.mark.parametrize(
    ("policy", "observation_size"), [("tracker", 635), pytest.param("twist2", 1432, marks=pytest.mark.assets)]
)
def test_it_states_its_configuration_and_writes_every_key_as_its_contract_says(
    bus_server: BusAddress, policy: str, observation_size: int
) -> None:
    with logged(bus_server) as log, G1Process(bus_server, f"policy={policy}") as server:
        wait_until(lambda: ticks(log) > 20)
        code, out, err = server.finish()
    assert code == 0, err
    assert out == ""
    config = codec.parse_json(log.last(keys.server_config("g1")))
    assert config["policy"]["name"] == policy
    assert config["policy"]["sha256"] == assets.sha256(assets.resolve(checkpoint_of(policy)))
    assert len(config["policy"]["kp"]) == len(config["policy"]["joint_names"]) == 29
    assert config["robot_facts"]["physics_dt_s"] == 0.001
    assert config["config"]["pace"] == "wall"
    order = [write.key for write in log.writes]
    assert order.index(keys.server_config("g1")) < order.index(keys.robot_state(ROBOT))
    for key in _STATE_KEYS + _RESULT_KEYS:
        _assert_fits(key, log.values(key), observation_size)
    first = codec.parse_json_vector(log.values(twist_keys.state_body(ROBOT))[0])
    assert first[5:].any(), "stock servers begin with zeros; ours with the first real state"
    assert codec.parse_json_vector(log.values(keys.policy_timing(ROBOT))[0])[0] == 1
    state, now_ms = int(log.last(twist_keys.T_STATE)), time.time_ns() // 1_000_000
    assert 0 <= now_ms - state < 60_000


def _assert_fits(key: str, values: list[bytes], observation_size: int) -> None:
    contract = contracts.contract(key)
    assert contract is not None
    assert values
    sizes = {keys.policy_obs(ROBOT): observation_size, keys.policy_action(ROBOT): 29}
    for value in values:
        match contract.codec:
            case "json-vector":
                numbers = json.loads(value)
                assert json.dumps(numbers).encode() == value, "byte for byte what Python's encoder writes"
                assert len(numbers) == len(contract.elements)
            case "f64":
                assert len(value) == 8 * len(contract.elements)
            case "f32":
                assert len(value) == 4 * sizes[key]
            case "integer":
                assert value.isdigit()
            case _:
                assert isinstance(json.loads(value), dict)


def test_the_keys_of_a_tick_are_written_together_and_in_turn(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *LIGHT):
        wait_until(lambda: ticks(log) > 20)
    wanted = set(_STATE_KEYS + _RESULT_KEYS)
    order = [write.key for write in log.writes if write.key in wanted]
    tick = _STATE_KEYS + _RESULT_KEYS
    first = [set(order[i * len(tick) : i * len(tick) + len(_STATE_KEYS)]) for i in range(15)]
    assert all(keys_of_state == set(_STATE_KEYS) for keys_of_state in first)
    mono = [write.stamp.split(b" ")[1] for write in log.writes if write.key in _RESULT_KEYS and write.stamp][:6]
    assert len(set(mono)) == 1


@pytest.mark.torch
@pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
def test_with_a_twist_policy_it_writes_the_keys_of_twist(bus_server: BusAddress, tmp_path: Path) -> None:
    import torch

    checkpoint = tmp_path / "twist.pt"
    torch.jit.save(torch.jit.script(torch.nn.Linear(1155, 23)), str(checkpoint))
    twist = twist_keys.TWIST_ROBOT
    settings = ("policy=twist", f"checkpoint={checkpoint}", "rate_hz=25")
    with logged(bus_server) as log, G1Process(bus_server, *LIGHT, *settings):
        wait_until(lambda: len(log.of(keys.policy_obs(twist))) > 15)
    for state, observation in zip(
        log.values(twist_keys.state_body(twist)), log.values(keys.policy_obs(twist))[:12], strict=False
    ):
        scaled = np.array(json.loads(state), dtype=np.float32)
        np.testing.assert_array_equal(scaled, codec.parse_f32(observation)[31:105])
    assert json.loads(log.last(twist_keys.state_hands(twist))) == [0.0] * 14
    assert len(codec.parse_f64(log.last(keys.command_used(twist)))) == 33
    assert not log.of(twist_keys.state_body(ROBOT))
    assert log.events("rate-differs")[0].detail == {"rate_hz": 25.0, "trained_hz": 50.0}
