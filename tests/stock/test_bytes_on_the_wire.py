"""Every TWIST and TWIST2 key that our servers write holds, byte for byte, what Python's own encoder writes."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.motions.npz_file import save
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station.bus import keys
from station.bus.client import Bus
from tests.adapters.motions.made import smooth
from tests.servers.g1_station import Log, logged
from tests.stock.conftest import OpenBus, Serve, finish
from tests.stock.stock_twist2 import ACTIONS, STATES
from tests.waiting import wait_until

LEFT_WRIST, RIGHT_WRIST = 0.11, -0.22
T1_ACTIONS = {"action_mimic_g1": 33, "action_hand_g1": 14}
T1_STATES = {"state_body_g1": 74, "state_hand_g1": 14}


@pytest.fixture
def log(open_bus: OpenBus, bus: Bus) -> Iterator[Log]:
    with logged(open_bus.address) as found:
        yield found


def holds_vectors(log: Log, lengths: dict[str, int]) -> None:
    """Assert it of every write of some keys: a flat list of floats, written as ``json.dumps`` writes it."""
    for key, length in lengths.items():
        values = log.values(key)
        assert len(values) > 20, key
        for value in values:
            vector = json.loads(value)
            assert value == json.dumps(vector).encode()
            assert {type(item) for item in vector} == {float}
            assert (key, len(vector)) == (key, length)


def holds_milliseconds(log: Log, key: str) -> None:
    """Assert it of every write: a bare decimal integer, the time of the wall clock."""
    values = log.values(key)
    assert len(values) > 20
    for value in values:
        assert value == str(int(value)).encode()
        assert json.loads(value) == int(value)
        assert abs(int(value) - time.time() * 1000) < 60_000
    assert values == sorted(values)


def test_twist2(serve: Serve, log: Log) -> None:
    g1, motion = serve("g1"), serve("motion", "motion=builtin:wave", "wait_for_start=true")
    wait_until(lambda: all(len(log.values(key)) > 30 for key in (twist_keys.action_body(), twist_keys.T_STATE)))
    finish(motion)
    finish(g1)
    holds_vectors(log, {**ACTIONS, **STATES})
    holds_milliseconds(log, "t_action")
    holds_milliseconds(log, "t_state")
    assert set(log.values(f"action_hand_left_{twist_keys.TWIST2_ROBOT}")) == {json.dumps([0.0] * 7).encode()}
    assert log.values("motion_start_signal") == log.values("motion_exit_signal") == [b"0"]


@pytest.fixture
def wrists(tmp_path: Path) -> Path:
    """A motion whose wrist rolls stand still and differ."""
    walk, path = smooth(frames=60), tmp_path / "wrists.npz"
    q = walk.q.copy()
    q[:, G1_29.index("left_wrist_roll")] = LEFT_WRIST
    q[:, G1_29.index("right_wrist_roll")] = RIGHT_WRIST
    save(path, fps=walk.fps, root_pos=walk.root_pos, root_quat_wxyz=walk.root_quat_wxyz, joint_pos=q,
         joint_names=G1_29)  # fmt: skip
    return path


def test_twist_commands_carry_the_wrist_rolls_where_stock_takes_them_out(serve: Serve, log: Log, wrists: Path) -> None:
    motion = serve("motion", f"motion={wrists}", "format=twist", "enter_s=0.2")
    wait_until(lambda: len(log.values("action_mimic_g1")) > 60)
    finish(motion)
    holds_vectors(log, T1_ACTIONS)
    holds_milliseconds(log, "t_action")
    playing = json.loads(log.values("action_mimic_g1")[40])
    assert playing[27] == pytest.approx(LEFT_WRIST)
    assert playing[32] == pytest.approx(RIGHT_WRIST)
    # What stock hands to its policy: 31 numbers, the last of the right arm being the elbow.
    policy = [value for index, value in enumerate(playing) if index not in (27, 32)]
    assert len(policy) == 31
    assert LEFT_WRIST not in policy
    assert RIGHT_WRIST not in policy
    assert set(log.values("action_hand_g1")) == {json.dumps([0.0] * 14).encode()}
    assert log.values(twist_keys.action_body()) == []


@pytest.mark.torch
@pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
def test_twist_robot_answers_with_74_scaled_numbers(bus: Bus, serve: Serve, log: Log, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    network = torch.nn.Linear(1155, 23)
    torch.nn.init.zeros_(network.weight)
    torch.nn.init.zeros_(network.bias)
    torch.jit.save(torch.jit.script(network), str(tmp_path / "stand.pt"))
    g1 = serve("g1", "policy=twist", f"checkpoint={tmp_path / 'stand.pt'}")
    body = [0.793] + [0.0] * 7 + [-0.2, 0, 0, 0.4, -0.2, 0] * 2 + [0.0] * 3
    body += [0, 0.2, 0, 1.2, LEFT_WRIST, 0, -0.2, 0, 1.2, RIGHT_WRIST]
    followed = 0
    while followed < 100:
        bus.call("SET", "action_mimic_g1", json.dumps([float(value) for value in body]).encode())
        time.sleep(0.02)
        followed = sum(b'"tracking"' in value for value in log.values(keys.command_gate(twist_keys.TWIST_ROBOT)))
    finish(g1)
    holds_vectors(log, T1_STATES)
    steps = zip(log.values(keys.target("g1")), log.values(keys.command_gate(twist_keys.TWIST_ROBOT)), strict=False)
    target = [np.frombuffer(value)[:29] for value, gate in steps if b'"tracking"' in gate][-1]
    assert target[G1_29.index("left_wrist_roll")] == pytest.approx(LEFT_WRIST)
    assert target[G1_29.index("right_wrist_roll")] == pytest.approx(RIGHT_WRIST)
    assert log.values(f"state_body_{twist_keys.TWIST2_ROBOT}") == []
