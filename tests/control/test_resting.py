"""A robot that stays where it is without a command, and whose joints are asked for positions: where it rests, and whom
it follows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.policies.direct import DirectPolicy
from station.bus import codec
from station.contract import Element
from station.control.command_validator import CommandSample
from station.control.control import ControlStep, StepRecord
from station.errors import ConfigError
from station.protocols import Floats, JointTargets, RobotState
from tests import six_joints
from tests.adapters.policies.test_direct import FILE
from tests.control.ideal_robot import IdealRobot

DT = 0.01
START = np.array([0.1, -0.2, 0.3, 0.0, 0.5, 0.0])
SAG = np.array([0.0, 0.05, 0.02, 0.0, 0.0, 0.0])


class Arm(IdealRobot):
    """Hangs a little below where it is asked to be, like any arm that is not infinitely stiff."""

    joint_names = six_joints.JOINTS

    def __init__(self) -> None:
        super().__init__()
        self.q = START.copy()

    def read(self) -> RobotState:
        return replace(super().read(), q=self.q.copy(), dq=np.zeros(6))

    def write(self, targets: JointTargets) -> JointTargets:
        self.written.append(targets)
        self.q = np.where(targets.kp > 0, targets.q - SAG, self.q)
        return targets


class Bench:
    """A control step over an arm, and a commander."""

    def __init__(self, folder: Path, arm: Arm | None = None, *, is_armed: bool = True) -> None:
        file = folder / "six.yaml"
        file.write_text(FILE)
        self.arm = arm or Arm()
        self.control = ControlStep(self.arm, DirectPolicy(file), six_joints.COMMAND, is_armed=is_armed)
        self.tick = 0
        self.sample: CommandSample | None = None

    def step(self, command: Floats | None = None) -> StepRecord:
        self.tick += 1
        if command is not None:
            self.sample = CommandSample(codec.json_vector(command), arrived_s=self.tick * DT)
        return self.control.step(self.control.sense(), self.sample, self.tick * DT)

    def steps(self, count: int, command: Floats | None = None) -> StepRecord:
        return [self.step(command) for _ in range(count)][-1]


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    six_joints.register(monkeypatch)
    return Bench(tmp_path)


@pytest.fixture
def disarmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    six_joints.register(monkeypatch)
    return Bench(tmp_path, is_armed=False)


def test_nobody_commands_and_it_stays_where_it_was_asked_to_be_instead_of_sagging_on(bench: Bench) -> None:
    record = bench.steps(500)
    assert record.decision.state == "waiting"
    np.testing.assert_array_equal(record.sent.q, START)
    np.testing.assert_array_equal(record.decision.vector, START)


def test_a_command_is_entered_at_its_rate_and_rests_where_it_ended(bench: Bench) -> None:
    bench.step()
    goal = START + 0.4
    sent = np.array([bench.step(goal).sent.q for _ in range(100)])
    assert np.abs(np.diff(sent, axis=0)).max() <= 1.0 * DT + 1e-12
    np.testing.assert_allclose(sent[-1], goal)
    record = bench.steps(300)
    assert record.decision.state == "waiting"
    np.testing.assert_allclose(record.sent.q, goal)


def test_after_a_stop_it_rests_where_it_is_and_who_commanded_has_to_begin_anew(bench: Bench) -> None:
    goal = START + 0.4
    bench.steps(100, goal)
    bench.control.stop("test")
    assert not bench.step(goal).sent.kp.any()
    bench.arm.q = START - 0.3  # it sank, or was pushed
    bench.steps(20, goal)
    bench.control.reset("test")
    bench.control.arm(bench.tick * DT)
    record = bench.steps(300, goal)
    assert record.decision.state == "waiting"
    np.testing.assert_array_equal(record.sent.q, START - 0.3)
    bench.steps(60)
    assert bench.steps(200, goal).decision.state == "tracking"


def test_while_it_is_disarmed_nobody_is_followed_and_who_commanded_has_to_begin_anew(disarmed: Bench) -> None:
    goal = START + 0.4
    record = disarmed.steps(100, goal)
    assert record.decision.state == "waiting"
    assert record.decision.reason == "the robot was disarmed; let go, then engage anew"
    assert not disarmed.arm.written
    assert disarmed.arm.damped == 100
    assert disarmed.control.arm(disarmed.tick * DT) == ""
    record = disarmed.steps(300, goal)
    assert disarmed.control.arming.state == "armed"
    assert record.decision.state == "waiting"
    np.testing.assert_array_equal(record.sent.q, START)
    disarmed.steps(60)
    np.testing.assert_allclose(disarmed.steps(200, goal).sent.q, goal)


def test_armed_again_it_rests_where_it_is_by_then(bench: Bench) -> None:
    bench.steps(100, START + 0.4)
    bench.control.disarm()
    bench.steps(50)
    bench.arm.q = START - 0.3  # it sank
    bench.step()
    bench.control.arm(bench.tick * DT)
    np.testing.assert_array_equal(bench.steps(300).sent.q, START - 0.3)


class Simulated(Arm):
    def reset(self) -> None:
        self.q = START.copy()


def test_a_simulated_arm_that_is_put_back_stays_there_and_not_where_it_lay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    six_joints.register(monkeypatch)
    bench = Bench(tmp_path, Simulated())
    bench.steps(100, START + 0.4)
    bench.control.stop("test")
    bench.step()
    bench.arm.q = START - 1.0
    bench.tick += 1
    before = bench.control.sense()  # as the loop does: it reads, is told of the release, and steps
    bench.control.reset("test")
    bench.control.step(before, bench.sample, bench.tick * DT)
    np.testing.assert_array_equal(bench.steps(300).sent.q, START)


class Blocked(Arm):
    """Somebody holds it."""

    def write(self, targets: JointTargets) -> JointTargets:
        self.written.append(targets)
        return targets


def test_an_arm_that_is_held_up_is_pushed_no_farther_than_its_lead_and_rests_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    six_joints.register(monkeypatch)
    bench = Bench(tmp_path, Blocked())
    record = bench.steps(300, START + 1.2)
    np.testing.assert_allclose(record.sent.q, START + 0.3)
    record = bench.steps(100)
    assert record.decision.state == "waiting"
    np.testing.assert_allclose(record.sent.q, START + 0.3)


def test_a_command_of_other_joints_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    six_joints.register(monkeypatch)
    file = tmp_path / "six.yaml"
    file.write_text(FILE)
    other = replace(six_joints.COMMAND, elements=(Element("tool_x", "m"), *six_joints.COMMAND.elements[1:]))
    with pytest.raises(ConfigError, match="what stays takes positions of joints; command 'six' has tool_x"):
        ControlStep(Arm(), DirectPolicy(file), other)
