"""Handing over between policies, step by step, without a bus: who observes, who drives, what is sent, what is told."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29
from station import registry
from station.bus import codec
from station.control.command_path import StepEvent
from station.control.command_validator import CommandSample
from station.control.control import ControlStep, StepRecord
from station.control.policy_switch import LISTEN_S, PolicySwitch
from station.errors import ConfigError, Refused, UnknownName
from station.protocols import Floats, Floats32, JointTargets, RobotState
from tests.control.ideal_robot import IdealRobot, Obedient

FORMAT = registry.find("command", "twist2")
DT = 0.02
LISTEN = round(LISTEN_S / DT)
BLEND_S, BLEND = 0.1, 5


class Counting(Obedient):
    """Asks for what the command says and an offset, and counts what it saw since its last reset."""

    def __init__(self, offset: float = 0.0, kp: float = 50.0) -> None:
        super().__init__()
        self.spec = replace(self.spec, kp=np.full(29, kp))
        self.offset, self.seen, self.acted = offset, 0, 0
        self.why_not = ""

    def reset(self) -> None:
        super().reset()
        self.seen = self.acted = 0

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        self.seen += 1
        return super().observe(state, command)

    def act(self, observation: Floats32) -> Floats32:
        self.acted += 1
        return super().act(observation)

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        return JointTargets(action.astype(np.float64) + self.offset, self.spec.kp, self.spec.kd)

    def why_not_take_over(self, state: RobotState, command: Floats) -> str:
        assert self.seen == LISTEN, "it is asked once it has seen where the robot is"
        return self.why_not


class Bench:
    """A robot with two policies, `old` and `new`, that follows a command."""

    def __init__(self) -> None:
        self.old, self.new = Counting(), Counting(offset=0.2, kp=80.0)
        self.switch = PolicySwitch({"old": self.old, "new": self.new}, period_s=DT, blend_s=BLEND_S)
        self.robot = IdealRobot()
        self.control = ControlStep(self.robot, self.switch, FORMAT)
        self.told: list[StepEvent] = []
        self.tick = 0
        for _ in range(60):
            self.step()

    def step(self) -> StepRecord:
        self.tick += 1
        sample = CommandSample(codec.json_vector(FORMAT.default), arrived_s=self.tick * DT)
        record = self.control.step(self.control.sense(), sample, self.tick * DT)
        self.told += record.step_events
        return record

    def steps(self, count: int) -> list[StepRecord]:
        return [self.step() for _ in range(count)]

    def events(self) -> list[tuple[str, dict[str, Any]]]:
        return [(each.name, each.detail) for each in self.told if each.name.startswith("policy")]


def test_the_next_policy_observes_then_its_targets_are_blended_in_then_it_drives_alone() -> None:
    bench = Bench()
    before = bench.step()
    assert (before.policy, before.next_policy) == ("old", "")
    assert bench.new.seen == 0, "a policy that is not asked for costs nothing"
    bench.switch.switch("new", who="ada")

    listening = bench.steps(LISTEN)
    assert {(each.policy, each.next_policy) for each in listening} == {("old", "new")}
    assert bench.new.seen == bench.new.acted == LISTEN
    assert all((each.sent.q == before.sent.q).all() for each in listening), "what listens moves nothing"

    blending = bench.steps(BLEND)
    assert {(each.policy, each.next_policy) for each in blending} == {("new", "")}
    shares = [(each.sent.q[0] - before.sent.q[0]) / 0.2 for each in blending]
    assert shares == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    assert [each.sent.kp[0] for each in blending] == pytest.approx([56.0, 62.0, 68.0, 74.0, 80.0])
    assert bench.old.seen == bench.tick, "it observes as long as its targets count"

    seen = bench.old.seen
    bench.steps(3)
    assert bench.old.seen == seen
    assert bench.events() == [("policy-switched", {"policy": "new", "before": "old", "blend_s": BLEND_S, "who": "ada"})]


def test_it_goes_back_and_forth() -> None:
    bench = Bench()
    for name in ("new", "old", "new"):
        bench.switch.switch(name)
        bench.steps(LISTEN + BLEND)
        assert bench.step().policy == name
    assert [name for name, _ in bench.events()] == ["policy-switched"] * 3


def test_what_cannot_be_done_is_refused_with_the_reason() -> None:
    bench = Bench()
    with pytest.raises(UnknownName, match=r"unknown policy of this robot 'nwe' \(did you mean 'new'"):
        bench.switch.switch("nwe")
    with pytest.raises(Refused, match="'old' drives already"):
        bench.switch.switch("old")
    bench.switch.switch("new")
    for _ in range(LISTEN + BLEND - 1):
        bench.step()
        with pytest.raises(Refused, match="'old' hands over to 'new' just now; ask again when that is done"):
            bench.switch.switch("new")
    bench.step()
    bench.switch.switch("old")


def test_a_policy_that_cannot_take_over_from_here_says_why_and_the_old_one_drives_on() -> None:
    bench = Bench()
    bench.new.why_not = "it was never trained lying down"
    bench.switch.switch("new", who="ada")
    before = bench.step()
    for record in bench.steps(LISTEN + BLEND + 2):
        assert record.policy == "old"
        assert (record.sent.q == before.sent.q).all()
    assert bench.switch.refusal == "it was never trained lying down"
    assert bench.events() == [("policy-switch-refused", {
        "policy": "new", "drives": "old", "reason": "it was never trained lying down", "who": "ada",
    })]  # fmt: skip
    bench.new.why_not = ""
    bench.switch.switch("new")
    assert bench.switch.refusal == ""
    bench.steps(LISTEN + BLEND)
    assert bench.step().policy == "new"


def test_a_policy_whose_output_is_not_finite_does_not_take_over() -> None:
    bench = Bench()
    bench.new.is_broken = True
    bench.switch.switch("new")
    before = bench.step()
    assert all((each.policy, each.sent.kp[0]) == ("old", 50.0) for each in bench.steps(LISTEN + BLEND))
    assert bench.switch.refusal == "its output is not finite"
    assert before.next_policy == "new"
    assert "bad-action" not in [each.name for each in bench.told], "what listens is no fault of what drives"


def test_where_the_one_that_drives_gives_no_number_the_one_that_listens_takes_over_at_once() -> None:
    bench = Bench()
    bench.switch.switch("new")
    bench.steps(3)
    bench.old.is_broken = True
    assert (bench.step().sent.kp == 0.0).all(), "damped: this step has no good action"
    record = bench.step()
    assert (record.policy, record.next_policy) == ("new", "")
    assert (record.sent.kp == 80.0).all()
    assert bench.new.seen == 5, "its history goes on"


def test_where_the_new_one_breaks_while_targets_are_blended_the_old_one_drives_on() -> None:
    bench = Bench()
    bench.switch.switch("new")
    bench.steps(LISTEN + 2)
    resets = bench.old.resets
    bench.new.is_broken = True
    assert (bench.step().sent.kp == 0.0).all()
    record = bench.step()
    assert (record.policy, record.next_policy) == ("old", "")
    assert (record.sent.kp == 50.0).all()
    assert bench.old.resets == resets, "its history goes on"
    assert bench.switch.refusal == "its output is not finite", "whoever asked must not be told that it drives"
    assert [(name, detail["policy"]) for name, detail in bench.events()] == [
        ("policy-switched", "new"), ("policy-switched", "old"),
    ]  # fmt: skip


def test_where_the_old_one_breaks_while_targets_are_blended_the_new_one_drives_alone() -> None:
    bench = Bench()
    bench.switch.switch("new")
    bench.steps(LISTEN + 2)
    seen, bench.old.is_broken = bench.new.seen, True
    for record in bench.steps(3):
        assert record.policy == "new"
        assert (record.sent.kp == 80.0).all()
    assert bench.new.seen == seen + 3, "its history goes on"
    assert "bad-action" not in [each.name for each in bench.told]


def test_a_stop_and_its_release_end_the_switch_with_the_new_policy() -> None:
    bench = Bench()
    bench.switch.switch("new")
    bench.steps(2)
    bench.control.stop("test")
    assert all((each.sent.kp == 0.0).all() for each in bench.steps(2))
    bench.control.reset("released")
    assert bench.switch.driving == "new"
    assert bench.new.seen == 0, "a robot that starts anew has no history"
    assert (bench.switch.next, bench.step().policy) == ("", "new")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"command": "twist"}, "'new' follows 'twist' commands, 'old' follows 'twist2'"),
        ({"joint_names": G1_29[::-1]}, "'new' drives other joints than 'old', or in another order"),
        ({"rate_hz": 100.0}, "'new' was trained at 100 Hz, 'old' at 50 Hz"),
    ],
)
def test_policies_that_cannot_share_a_robot_are_refused_before_it_starts(change: dict[str, Any], words: str) -> None:
    old, new = Counting(), Counting()
    new.spec = replace(new.spec, **change)
    with pytest.raises(ConfigError, match=words.replace("'", ".")):
        PolicySwitch({"old": old, "new": new}, period_s=DT)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_is_asked_and_breaks_when_targets_are_finite_and_one_known_policy_drives(seed: int) -> None:
    random, bench = Random(seed), Bench()
    for _ in range(200):
        bench.old.is_broken, bench.new.is_broken = (random.random() < 0.03 for _ in range(2))
        bench.new.why_not = "not now" if random.random() < 0.1 else ""
        chance = random.random()
        if chance < 0.05:
            bench.control.stop("test")
            bench.step()
            bench.control.reset("released")
        elif chance < 0.3:
            with contextlib.suppress(Refused):
                bench.switch.switch(random.choice(("old", "new")))
        record = bench.step()
        assert record.policy in bench.switch.names
        assert record.next_policy in ("", "old", "new")
        assert record.next_policy != record.policy
        assert all(np.isfinite(each).all() for each in (record.sent.q, record.sent.kp, record.sent.kd))
        if record.sent.kp.any():  # it is not damped
            assert (record.sent.q - record.decision.vector[6:] <= 0.2 + 1e-6).all()
