"""Cases on the built-in robot and policy: real physics, a few seconds each."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from adapters.policies.twist2 import DEFAULT_Q, gains
from station import registry
from station.control.rig import Rig, RigConfig, build
from station.errors import ConfigError
from station.protocols import Fall, JointTargets, Robot, RobotState, SimulatedRobot
from station.rehearse import rehearse
from station.suite import trial
from station.suite.cases import Arms, Cut, Push, Stand, Track
from station.suite.promise import SILENCES
from station.suite.trial import run_case
from tests.suite.made import TRACKER, limp_network


@pytest.fixture(scope="module")
def limp(tmp_path_factory: pytest.TempPathFactory) -> RigConfig:
    network = limp_network(tmp_path_factory.mktemp("limp") / "limp.onnx")
    return msgspec.structs.replace(TRACKER, checkpoint=str(network))


@pytest.fixture(scope="module")
def robot() -> SimulatedRobot:
    made = build(TRACKER).robot
    assert isinstance(made, SimulatedRobot)
    return made


def test_a_clip_goes_as_it_does_in_a_rehearsal_bit_for_bit() -> None:
    outcome = run_case(Track(group="track", seconds=8.0, clip="builtin:reach-left"), TRACKER)
    rig = build(TRACKER)
    clip = registry.find("loader", "motion")("builtin:reach-left")
    alone = rehearse(clip, rig.policy, rig.robot, rig.command_format, period_s=rig.period_s)
    assert outcome.falls == ()
    assert outcome.joint_error_rad == alone.mean_joint_error_rad
    assert outcome.simulated_s == alone.seconds


def test_standing_is_measured_by_how_far_it_drifts() -> None:
    outcome = run_case(Stand(group="stand", seconds=4.0), TRACKER)
    assert outcome.case == "stand 4 s"
    assert outcome.falls == ()
    assert outcome.drift is not None
    assert 0.0 < outcome.drift.end_m <= outcome.drift.greatest_m < 0.3
    assert outcome.joint_error_rad is None
    assert outcome.simulated_s == pytest.approx(4.0)
    assert 0.0 < outcome.lean_rad < 0.3


def test_a_policy_that_lets_go_falls_and_it_is_said_when_and_how(limp: RigConfig) -> None:
    outcome = run_case(Stand(group="stand", seconds=10.0), limp)
    (fell,) = outcome.falls
    assert 0.5 < fell.at_s < 4.0
    assert fell.at_s == pytest.approx(outcome.simulated_s)
    assert fell.gate == "waiting"
    assert fell.contacts or fell.lean_rad > math.radians(60.0)
    assert outcome.lean_rad >= fell.lean_rad
    assert outcome.drift is None


def test_random_arms_go_on_after_a_fall_so_that_falls_can_be_counted(limp: RigConfig) -> None:
    outcome = run_case(Arms(group="arms", seconds=8.0, seed=1), limp)
    assert len(outcome.falls) >= 2
    assert outcome.simulated_s == pytest.approx(8.0)
    assert outcome == msgspec.structs.replace(
        run_case(Arms(group="arms", seconds=8.0, seed=1), limp), wall_s=outcome.wall_s
    ), "a seed makes it the same every time"


def test_a_hard_push_throws_the_robot_after_its_instant_and_a_light_one_does_not() -> None:
    def push(speed_mps: float, clip: str = "") -> Any:
        case = Push(group="push", seconds=3.0, speed_mps=speed_mps, towards_rad=math.pi / 2, at_s=1.0, clip=clip)
        return run_case(case, TRACKER)

    assert push(0.05).falls == ()
    assert push(0.05, "builtin:wave").falls == ()
    (fell,) = push(4.0).falls
    assert 1.0 < fell.at_s < 3.0


def test_commands_that_break_off_and_come_back_leave_a_robot_that_stands_standing() -> None:
    for silence in SILENCES:
        case = Cut(group="gate", seconds=2.0 + silence.seconds + 2.0, clip="builtin:stand", at_s=2.0, silence=silence)
        outcome = run_case(case, TRACKER)
        assert outcome.falls == ()
        assert outcome.joint_error_rad is not None, "it follows again"


@pytest.mark.parametrize(
    ("late_s", "period_s", "expected"), [(0.0, 0.02, 0), (0.02, 0.02, 1), (0.02, 0.01, 2), (0.02, 0.015, 2)]
)
def test_a_delay_is_the_fewest_periods_that_last_as_long(late_s: float, period_s: float, expected: int) -> None:
    assert trial.periods(late_s, period_s) == expected


def test_late_targets_are_those_of_some_periods_before(robot: SimulatedRobot) -> None:
    slow = trial.LateRobot(robot, 2)
    assert isinstance(slow, SimulatedRobot)
    kp, kd = gains(4.0, 0.2)
    sent = [JointTargets(DEFAULT_Q + 0.01 * k, kp, kd) for k in range(5)]
    for _ in range(2):
        slow.reset()
        applied = [slow.write(targets) for targets in sent]
        assert [targets.q[0] for targets in applied] == [sent[k].q[0] for k in (0, 0, 0, 1, 2)]


def test_a_delay_changes_what_happens() -> None:
    on_time, late_by_20_ms = (
        run_case(Track(group="late", seconds=8.0, clip="builtin:reach-left", late_s=late_s), TRACKER)
        for late_s in (0.0, 0.02)
    )
    assert on_time.joint_error_rad != late_by_20_ms.joint_error_rad
    assert late_by_20_ms.case == "builtin:reach-left, 20 ms late"


class RealRobot:
    """A robot that can be neither pushed nor put back on its feet."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.joint_names = robot.joint_names

    def read(self) -> RobotState:
        return self._robot.read()

    def write(self, targets: JointTargets) -> JointTargets:
        return self._robot.write(targets)

    def fallen(self) -> Fall | None:
        return self._robot.fallen()

    def facts(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        pass


def test_a_robot_that_is_not_simulated_is_refused(robot: SimulatedRobot) -> None:
    rig = build(TRACKER)
    real: Rig = msgspec.structs.replace(rig, robot=RealRobot(robot))
    for case in (Stand(group="stand", seconds=1.0), Arms(group="arms", seconds=1.0, seed=1)):
        with pytest.raises(ConfigError, match="RealRobot cannot be put back on its feet and pushed"):
            trial._run(case, real)


@pytest.mark.assets
def test_twist2_stands_up_to_the_pushes_that_are_promised(assets: Path) -> None:
    config = msgspec.structs.replace(TRACKER, policy="twist2", checkpoint="")
    for towards_rad in np.radians([0.0, 135.0]).tolist():
        case = Push(group="push", seconds=6.0, speed_mps=0.4, towards_rad=towards_rad, at_s=2.0)
        assert run_case(case, config).falls == ()
