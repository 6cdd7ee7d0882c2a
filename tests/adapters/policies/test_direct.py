"""Joints go where the command says, to the last bit; a file that does not fit is refused in a line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.policies.direct import DirectPolicy
from station.errors import StationError
from station.protocols import RobotState
from tests import six_joints

JOINTS = "\n".join(f"  - {{name: {name}, kp: {100 + number}, kd: 5}}" for number, name in enumerate(six_joints.JOINTS))
FILE = f"command: six\nrate_hz: 100\njoints:\n{JOINTS}\n"
STATE = RobotState(1, np.zeros(6), np.zeros(6), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))


@pytest.fixture(autouse=True)
def _known(monkeypatch: pytest.MonkeyPatch) -> None:
    six_joints.register(monkeypatch)


def written(folder: Path, text: str) -> Path:
    path = folder / "six.yaml"
    path.write_text(text)
    return path


def test_targets_are_the_command_to_the_last_bit_and_the_observation_is_it_in_single_precision(tmp_path: Path) -> None:
    policy = DirectPolicy(written(tmp_path, FILE))
    command = np.array([1.0 / 3.0, -0.1, 0.2, 0.7, -1.9, 0.0])
    observation = policy.observe(replace(STATE, q=command - 0.01), command)
    assert (observation.dtype, observation.tolist()) == (np.float32, command.astype(np.float32).tolist())
    targets = policy.targets(policy.act(observation), command)
    assert targets.q.tobytes() == command.tobytes()
    assert targets.kp.tolist() == [100.0, 101.0, 102.0, 103.0, 104.0, 105.0]
    assert targets.kd.tolist() == [5.0] * 6


def test_its_file_says_for_which_joints_and_commands_it_is(tmp_path: Path) -> None:
    spec = DirectPolicy(written(tmp_path, FILE.replace("kp: 100, kd: 5", "kp: 100, kd: 5, default_rad: 0.5"))).spec
    assert (spec.name, spec.command, spec.rate_hz, spec.joint_names) == ("direct", "six", 100.0, six_joints.JOINTS)
    assert spec.default_q.tolist() == [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert len(spec.sha256) == 64


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (FILE.replace("command: six", "command: sxi"), "unknown command 'sxi' (did you mean 'six'?)"),
        (FILE.replace("name: base", "name: bass"), "a command 'six' has base_pos, shoulder_pos"),
        (FILE.replace("kp: 103", "kp: 0"), "forearm: kp 0, kd 5; expected a stiffness above 0"),
        (FILE.replace("kp: 103", "kp: .nan"), "forearm: kp nan, kd 5; expected a stiffness above 0"),
        (FILE.replace("rate_hz: 100", "rate_hz: often"), "rate_hz"),
        (FILE.replace("rate_hz: 100", "rate_hz: 100\nlead_rad: 0"), "lead_rad is 0; expected more than 0"),
        (FILE.replace("kd: 5", "kd: 5, ki: 1"), "ki"),
        (FILE.replace("rate_hz: 100\n", ""), "rate_hz"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_with_its_name_and_what_is_wrong(
    tmp_path: Path, text: str, line: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(StationError) as refused:
        DirectPolicy(path)
    assert str(refused.value).startswith(str(path))
    assert line in str(refused.value)


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(StationError, match=r"none\.yaml: no such file"):
        DirectPolicy(tmp_path / "none.yaml")
