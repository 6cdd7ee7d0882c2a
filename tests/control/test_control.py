"""One tick: what goes to the policy and to the robot, and what is told, without a bus.

The robot here is ideal (a joint is at its target after one tick) and the policy asks for what the command says, so
that what the step itself does can be seen. The real ones run in `tests/test_rehearse.py` and `tests/servers`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29
from station import registry
from station.bus import codec
from station.control.command_path import StepEvent
from station.control.command_validator import CommandSample
from station.control.control import ControlStep, StepRecord
from station.errors import ConfigError
from station.protocols import Fall
from tests.control.ideal_robot import IdealRobot, IdealSimulation, Obedient

FORMAT = registry.find("command", "twist2")
DT = 0.02


class Bench:
    """A control step and a commander."""

    def __init__(self, robot: IdealRobot | None = None, *, is_armed: bool = True) -> None:
        self.robot = robot or IdealRobot()
        self.policy = Obedient()
        self.control = ControlStep(self.robot, self.policy, FORMAT, is_armed=is_armed)
        self.tick = 0
        self.sample: CommandSample | None = None
        self.told: list[StepEvent] = []

    def step(self, value: bytes | None = None, **known: Any) -> StepRecord:
        self.tick += 1
        if value is not None:
            self.sample = CommandSample(value, arrived_s=self.tick * DT, **known)
        record = self.control.step(self.control.sense(), self.sample, self.tick * DT)
        self.told += record.step_events
        return record

    def track(self, value: bytes | None = None) -> StepRecord:
        for _ in range(60):
            record = self.step(value or _command())
        assert record.decision.state == "tracking"
        return record

    def names(self) -> list[str]:
        return [step_event.name for step_event in self.told]


def _command(knee: float = 0.7) -> bytes:
    vector = FORMAT.default.copy()
    vector[6 + 3] = knee
    return codec.json_vector(vector)


def test_a_tracked_command_reaches_the_joints() -> None:
    bench = Bench()
    record = bench.track()
    assert record.sent.q[3] == pytest.approx(0.7)
    np.testing.assert_array_equal(record.sent.kp, bench.policy.spec.kp)
    assert bench.robot.written[-1] is record.sent


def test_a_record_holds_the_instants_in_order_and_the_sequence_of_the_command_used() -> None:
    bench = Bench()
    bench.step(_command(), seq=41, written_ns=7, arrived_ns=9)
    record = bench.step(b"garbage", seq=42, written_ns=11, arrived_ns=12)
    assert record.command_seq == 41  # the newest good one; what was refused was not used
    written, arrived, read, observed, inferred, sent = record.timing_ns
    assert (written, arrived, read) == (7, 9, 1)
    assert read < observed <= inferred <= sent
    assert record.tick == 2


def test_without_a_command_the_robot_is_asked_to_stand() -> None:
    record = Bench().step()
    np.testing.assert_array_equal(record.decision.vector, FORMAT.default)
    assert record.command_seq == 0


def test_a_policy_that_loses_its_commander_is_asked_to_stop_walking_300_ms_after_the_last_command() -> None:
    bench, walking = Bench(), FORMAT.default.copy()
    walking[[0, 1, 5]] = 0.9, 0.1, 0.4
    bench.track(codec.json_vector(walking))
    asked = [bench.step().decision.vector[[0, 1, 5]] for _ in range(15)]
    assert asked[4].tolist() == [0.9, 0.1, 0.4]
    assert (np.diff(asked[4:], axis=0) < 0.0).all()
    assert asked[-1].tolist() == [0.0, 0.0, 0.0]


def test_the_gates_changes_are_told_with_from_to_and_reason() -> None:
    bench = Bench()
    bench.track()
    for _ in range(125):
        bench.step()
    changes = [(h.detail["from"], h.detail["to"]) for h in bench.told if h.name == "gate"]
    assert changes == [
        ("waiting", "entering"), ("entering", "tracking"), ("tracking", "holding"), ("holding", "returning"),
        ("returning", "waiting"),
    ]  # fmt: skip
    assert all(h.detail["reason"] for h in bench.told)


def test_refusals_are_told_when_they_begin_change_and_end_but_not_in_between() -> None:
    bench = Bench()
    bench.track()
    bench.told.clear()
    for _ in range(4):
        bench.step(b"garbage")
    for _ in range(3):
        bench.step(b"[1, 2]")
    for _ in range(3):
        bench.step(_command())
    told = [(h.name, h.detail.get("reason", "")[:8], h.detail["count"]) for h in bench.told if h.name != "gate"]
    assert told == [
        ("refused-command", "not-json", 1), ("refused-command", "wrong-le", 5), ("command-good-again", "", 7)
    ]  # fmt: skip


def test_the_stop_damps_the_joints_in_the_very_next_step_and_stays() -> None:
    bench = Bench()
    bench.track()
    bench.control.stop("button")
    for _ in range(10):
        record = bench.step(_command())
        assert record.decision.state == "stopped"
        assert not record.sent.kp.any()
        np.testing.assert_array_equal(record.sent.kd, bench.policy.spec.kd)
    assert bench.names().count("estop") == 1


def test_a_reset_of_the_stop_stands_a_simulation_up_and_only_a_command_that_begins_anew_is_entered() -> None:
    bench = Bench(IdealSimulation())
    bench.track()
    bench.control.stop("button")
    bench.step(_command())
    bench.control.reset("operator")
    assert {bench.step(_command()).decision.state for _ in range(55)} == {"waiting"}, "it ran on through the stop"
    assert bench.robot.resets == 1
    assert bench.policy.resets == 1
    for _ in range(20):
        bench.step()
    states = [bench.step(_command()).decision.state for _ in range(55)]
    assert states[0] == "entering"
    assert states[-1] == "tracking"
    assert "operator-reset" in bench.names()


def test_a_reset_without_a_stop_does_nothing() -> None:
    bench = Bench(IdealSimulation())
    bench.track()
    bench.control.reset("operator")
    assert bench.step(_command()).decision.state == "tracking"
    assert bench.robot.resets == 0


def test_a_disarmed_robot_is_damped_in_every_step_though_the_policy_runs() -> None:
    bench = Bench(is_armed=False)
    record = bench.track()
    assert not bench.robot.written
    assert bench.robot.damped == bench.tick
    assert not record.sent.kp.any()
    assert not record.sent.kd.any()
    assert record.action[3] == pytest.approx(0.7)


def test_an_armed_robot_grows_stiff_over_two_seconds() -> None:
    bench = Bench(is_armed=False)
    bench.step(_command())
    bench.control.arming.arm(bench.tick * DT)
    stiffness = [bench.step(_command()).sent.kp[0] for _ in range(101)]
    assert stiffness[0] == pytest.approx(0.5)
    assert stiffness[-1] == 50.0
    assert bench.robot.damped == 1, "before it was armed, and no more"
    bench.control.disarm("ada")
    written = len(bench.robot.written)
    bench.step(_command())
    assert (bench.robot.damped, len(bench.robot.written)) == (2, written), "at once, though commands come"
    assert np.diff(stiffness).max() <= 0.5 + 1e-9


def test_who_asks_to_arm_is_told_why_not_or_how_long_it_takes() -> None:
    bench = Bench(is_armed=False)
    for _ in range(5):
        bench.step(b"garbage")
    assert bench.control.arm(bench.tick * DT, "ada").startswith("commands come and are refused (not-json: ")
    bench.track()
    for _ in range(10):
        bench.step()
    assert bench.control.arm(bench.tick * DT).startswith("the command is stale (the newest good command is ")
    bench.step(_command())
    assert bench.control.arm(bench.tick * DT, "ada") == ""
    for _ in range(101):
        bench.step(_command())
    assert bench.control.arm(bench.tick * DT) == "", "armed already"
    bench.control.disarm("ada")
    bench.control.disarm("ada")
    bench.step(_command())
    told = [h.name for h in bench.told if "arm" in h.name]
    assert told == ["arm-refused", "arm-refused", "arming", "armed", "disarmed"]


def test_a_robot_that_has_fallen_or_a_policy_that_gives_no_numbers_is_not_armed() -> None:
    bench = Bench(is_armed=False)
    bench.robot.fall = Fall(1.2, ())
    bench.step()
    assert bench.control.arm(bench.tick * DT) == "the robot has fallen; put it on its feet"
    bench = Bench(is_armed=False)
    bench.policy.is_broken = True
    bench.step()
    assert bench.control.arm(bench.tick * DT) == "the policy's output is not finite"


def test_a_command_that_jumps_is_slewed_and_told_when_that_begins_and_when_it_has_ended() -> None:
    bench = Bench()
    bench.track(_command(0.0))
    before = 0.0
    for _ in range(40):
        knee = bench.step(_command(2.5)).sent.q[3]
        assert knee - before <= 20.0 * DT + 1e-6
        before = knee
    assert before == pytest.approx(2.5)
    told = [(h.severity, h.detail) for h in bench.told if h.name == "command-slewed"]
    assert told == [
        ("warning", {"elements": ["left_knee_pos"]}),
        ("warning", {"ended": True, "ticks": 6, "elements": ["left_knee_pos"]}),
    ]


def test_a_command_of_somebody_else_is_entered_with_a_blend() -> None:
    bench = Bench()
    for _ in range(60):
        bench.step(_command(0.0), source="a.1.boot.x")
    record = bench.step(_command(2.5), source="b.2.boot.x")
    assert record.decision.state == "entering"
    assert record.sent.q[3] == pytest.approx(0.0)
    assert record.decision.reason.startswith("b (pid 2 on another machine, boot boot) commands in place of a (pid 1")


def test_refused_commands_of_others_are_counted_and_are_the_reason_once_the_first_is_silent() -> None:
    bench = Bench()
    bench.track()
    for _ in range(10):
        bench.control.commanded.refuse_rivals(2, "a is obeyed")
        record = bench.step()
    assert bench.control.commanded.validator.refused["second-writer"] == 20
    assert (record.decision.state, record.decision.reason) == ("holding", "second-writer: a is obeyed")


def test_after_a_stop_a_real_robot_needs_arming_again_however_it_started() -> None:
    bench = Bench(is_armed=True)
    bench.track()
    bench.control.stop("button")
    assert bench.step().sent.kd.any()
    bench.control.reset("operator")
    assert bench.control.arming.state == "disarmed"
    assert Bench(IdealSimulation()).control.arming.state == "armed"


def test_after_a_stop_a_real_robot_needs_arming_again() -> None:
    bench = Bench(is_armed=False)
    bench.control.arming.arm(0.0)
    bench.track()
    bench.control.stop("button")
    assert bench.step().sent.kd.any()
    bench.control.reset("operator")
    assert not bench.step(_command()).sent.kd.any()
    assert bench.control.arming.state == "disarmed"


def test_an_output_that_is_not_finite_damps_the_joints_is_told_once_and_forgotten() -> None:
    bench = Bench()
    bench.track()
    bench.policy.is_broken = True
    for _ in range(3):
        record = bench.step(_command())
        assert not record.sent.kp.any()
        assert np.isfinite(record.sent.q).all()
    assert bench.names().count("bad-action") == 1
    assert bench.policy.resets == 3
    bench.policy.is_broken = False
    assert bench.step(_command()).sent.kp.all()


def test_a_state_that_is_not_finite_sends_no_nonsense() -> None:
    bench = Bench()
    bench.track()
    state = replace(bench.control.sense(), q=np.full(29, math.nan))
    bench.control.stop("button")
    record = bench.control.step(state, bench.sample, 2.0)
    assert np.isfinite(record.sent.q).all()


def test_a_fall_is_told_once_though_the_robot_bounces_and_again_after_it_stood() -> None:
    bench = Bench()
    down, up = Fall(1.2, ("pelvis",)), None
    for fall in [up] * 5 + [down] * 10 + [up] * 5 + [down] * 10 + [up] * 60 + [down] * 5:
        bench.robot.fall = fall
        bench.step()
    falls = [h for h in bench.told if h.name == "fall"]
    assert len(falls) == 2
    assert falls[0].detail == {"tilt_rad": 1.2, "contacts": ["pelvis"]}


def test_a_restart_after_a_fall_begins_anew() -> None:
    bench = Bench(IdealSimulation())
    bench.track()
    bench.robot.fall = Fall(1.2, ())
    bench.step(_command())
    bench.control.restart("fell")
    record = bench.step(_command())
    assert record.decision.state == "entering"
    assert record.fall is None
    assert bench.robot.resets == 1
    assert "robot-reset" in bench.names()


def test_a_restart_does_not_leave_the_stop() -> None:
    bench = Bench(IdealSimulation())
    bench.control.stop("button")
    bench.control.restart("fell")
    assert bench.step(_command()).decision.state == "stopped"


def test_a_policy_for_other_joints_or_commands_is_refused() -> None:
    policy = Obedient()
    policy.spec = replace(policy.spec, joint_names=G1_29[:28])
    with pytest.raises(ConfigError, match="drives 28 joints, the robot has 29; not in both: right_wrist_yaw"):
        ControlStep(IdealRobot(), policy, FORMAT)
    policy.spec = replace(policy.spec, joint_names=G1_29[::-1])
    with pytest.raises(ConfigError, match="order differs"):
        ControlStep(IdealRobot(), policy, FORMAT)
    with pytest.raises(ConfigError, match="follows 'twist2' commands, not 'twist'"):
        ControlStep(IdealRobot(), Obedient(), registry.find("command", "twist"))
