"""Nobody drives on: after whatever ended following but silence, commands have to cease before one is followed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from station.bus import codec
from station.bus.hearing import HearingProof
from station.control.arm_control import ArmControl
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig, QuietTime, ReengageInterlock
from tests.control.arm_bench import FORMAT, STEP
from tests.control.ideal_arm import TICK_S, IdealArm
from tests.examples import examples

NEEDED_S = GateConfig().return_after_s
PROBE_S, GAP_S = 0.05, 0.2  # of a watch that a robot's commands come by
NOTICED = round(GAP_S / TICK_S) + 1  # ticks; who is kept from writing for less, and has been silent before, let go


def insisted() -> ReengageInterlock:
    silence = ReengageInterlock(NEEDED_S)
    silence.insist("there was a stop")
    return silence


def ticks_until_kept(silence: ReengageInterlock, age_s: float, passed_s: float = TICK_S) -> int:
    """How many ticks of nothing new it takes; the age of what came last is `age_s` in the first of them."""
    for tick in range(1000):
        silence.on_tick(QuietTime(age_s + tick * passed_s), passed_s)
        if not silence.missing:
            return tick
    raise AssertionError("silence was never kept")


def test_without_insisting_no_silence_is_missing() -> None:
    assert ReengageInterlock(NEEDED_S).missing == ""


def test_it_is_kept_once_nothing_has_come_for_longer_than_needed() -> None:
    assert ticks_until_kept(insisted(), 0.0) == 76
    assert insisted().missing == "there was a stop; let go, then engage anew"


def test_silence_from_before_it_was_insisted_on_does_not_count() -> None:
    assert ticks_until_kept(insisted(), 60.0) == 76
    assert ticks_until_kept(insisted(), math.inf) == 76


def test_a_stalled_process_has_heard_no_silence() -> None:
    silence = insisted()
    silence.on_tick(QuietTime(0.0), TICK_S)
    silence.on_tick(QuietTime(5.0), 0.1)  # five seconds later, of which a tick counts for a tenth
    assert silence.missing
    silence.on_tick(QuietTime(0.0), TICK_S)  # what came meanwhile
    assert ticks_until_kept(silence, TICK_S) == 75


def test_what_nobody_knows_of_is_no_silence() -> None:
    silence = insisted()
    for tick in range(1000):  # the bus is frozen
        silence.on_tick(QuietTime(math.inf, unheard_s=tick * TICK_S), TICK_S)
    silence.on_tick(QuietTime(math.inf, math.nan), TICK_S)
    assert silence.missing
    silence.on_tick(QuietTime(0.0), TICK_S)  # it is back, and hears from now on
    assert ticks_until_kept(silence, TICK_S) == 75


def test_a_silence_is_kept_once_it_is_known_that_it_was_one() -> None:
    silence = insisted()
    for tick in range(77):
        silence.on_tick(QuietTime(math.inf, unheard_s=0.01), TICK_S)
        assert silence.missing, tick
    for _ in range(2):
        silence.on_tick(QuietTime(math.inf, unheard_s=0.01), TICK_S)
    assert not silence.missing


def test_what_comes_ends_a_silence_and_one_from_the_future_is_something_that_came() -> None:
    silence = insisted()
    for age_s in (0.2, 0.29, -0.5, math.nan):
        silence.on_tick(QuietTime(age_s), 0.1)
    assert silence.missing


class OneWhoDoesNotLetGo(RuleBasedStateMachine):
    """An arm, a commander, an operator of stop, faults and arming, a bus that is frozen and cut; and a history of all
    that was written, or would have been had the bus let it."""

    @initialize(is_simulated=st.booleans())
    def begin(self, is_simulated: bool) -> None:
        self.arm = IdealArm()
        self.arm.is_simulated = is_simulated
        self.control = ArmControl(self.arm, FORMAT, gate=GateConfig(), is_armed=True)
        self.now_s, self.seq, self.attempts = 100.0, 0, 0
        self.hearing, self.asked_s, self.is_well = HearingProof(GAP_S), self.now_s, True
        self.hearing.begin(round(self.now_s * 1e9))
        self.command = self.arm.q.copy()
        self.sample: CommandSample | None = None
        self.heard: list[float] = []  # when something was written, good or bad
        self.ended_s = -math.inf  # when following was last ended otherwise than by silence
        self.tick()

    # -- what is written -----------------------------------------------------------------------------------------
    def write(self, value: bytes) -> None:
        self.seq += 1
        self.heard.append(self.now_s)
        self.sample = CommandSample(value, arrived_s=self.now_s, seq=self.seq, source="teleop.1.b.n")

    def drive(self, ticks: int) -> None:
        for _ in range(ticks):
            self.now_s += TICK_S
            self.command = self.command + STEP * (-1) ** (self.seq // 200)
            self.write(codec.json_vector(self.command))
            self.tick()

    @rule(ticks=st.integers(1, 150))
    def driven(self, ticks: int) -> None:
        self.drive(ticks)

    @rule(ticks=st.integers(1, 120), what=st.sampled_from([b"[NaN,0,0,0,0,0,0]", b"[9,0,0,0,0,0,0]", b"hello"]))
    def garbage(self, ticks: int, what: bytes) -> None:
        for _ in range(ticks):
            self.now_s += TICK_S
            self.write(what)
            self.tick()

    @rule(ticks=st.integers(1, 120))
    def a_rival(self, ticks: int) -> None:
        for _ in range(ticks):
            self.now_s += TICK_S
            self.heard.append(self.now_s)
            self.control.commanded.refuse_rivals(1, "another commands")
            self.tick()

    @rule(ticks=st.integers(1, 120))
    def a_hole(self, ticks: int) -> None:
        for _ in range(ticks):
            self.now_s += TICK_S
            self.tick()

    @rule(ticks=st.integers(1, 300))
    def stalled(self, ticks: int) -> None:
        """The commander writes on; we see the clock first, and then what came."""
        for _ in range(ticks):
            self.now_s += TICK_S
            self.heard.append(self.now_s)
        self.is_well = False
        self.tick()
        self.is_well = True
        self.drive(1)

    def keep_from_writing(self, ticks: int) -> None:
        """Whoever commands goes on, and nothing of it comes."""
        for _ in range(ticks):
            self.now_s += TICK_S
            self.heard.append(self.now_s)
            self.tick()

    @rule(ticks=st.integers(NOTICED, 300), then=st.integers(0, 20))
    def frozen(self, ticks: int, then: int) -> None:
        """The bus is frozen; who commands gives up what it waits for, and connects anew a moment after it is back."""
        self.is_well = False
        self.keep_from_writing(ticks)
        self.is_well = True
        self.keep_from_writing(then)
        self.drive(1)

    @rule(ticks=st.integers(0, 300), then=st.integers(0, 20), finds=st.booleans())
    def cut_off(self, ticks: int, then: int, finds: bool) -> None:
        """Our own line is cut; who commands writes on, and its last write may be found when the line is back."""
        self.is_well = False
        self.keep_from_writing(ticks)
        self.is_well = True
        self.hearing.begin(round(self.now_s * 1e9))
        if finds:
            self.write(codec.json_vector(self.command))
            assert self.sample is not None
            self.sample = dataclasses.replace(self.sample, arrived_s=None)
        self.keep_from_writing(then)
        self.drive(1)

    # -- what ends following -------------------------------------------------------------------------------------
    @rule()
    def stop(self) -> None:
        self.control.stop("stop")

    @rule(then_arm=st.booleans())
    def reset(self, then_arm: bool) -> None:
        if self.control.commanded.gate.state == "stopped":
            self.ended_s = self.now_s
        self.control.reset("reset")
        if then_arm:
            self.control.arm(self.now_s, "reset")

    @rule()
    def fault(self) -> None:
        self.arm.fault = "safety 1010"
        self.arm.is_engaged = False

    @rule()
    def clear(self) -> None:
        if self.control.commanded.gate.state == "faulted":
            self.ended_s = self.now_s
        self.arm.clear()
        self.control.cleared("somebody")

    @rule()
    def disarm(self) -> None:
        self.control.disarm("somebody")

    @rule()
    def rearm(self) -> None:
        self.control.arm(self.now_s, "somebody")

    @rule()
    def revoke(self) -> None:
        if self.arm.is_engaged:
            self.ended_s = self.now_s
        self.arm.is_engaged = False

    @rule(refusal=st.sampled_from(["", "not now"]))
    def refuse(self, refusal: str) -> None:
        self.arm.refusal = refusal

    @rule()
    def begins_anew(self) -> None:
        """Who lets go and begins anew is followed where nothing stands in the way."""
        gate = self.control.commanded.gate
        self.a_hole(100)
        is_free = gate.state == "waiting" and self.control.commanded.arming.state == "armed" and not self.arm.refusal
        self.command = self.arm.q.copy()
        self.drive(2)
        assert gate.state == "tracking" or not is_free

    # -- a tick, and what must hold ------------------------------------------------------------------------------
    def tick(self) -> None:
        self.arm.pass_tick()
        self.probe()
        self.control.commanded.heard_all(*(at_ns * 1e-9 for at_ns in self.hearing.span))
        before = len(self.arm.engaged_at)
        record = self.control.step(self.control.sense(), self.sample, self.now_s)
        is_refused = "engage-refused" in [step_event.name for step_event in record.step_events]
        if len(self.arm.engaged_at) > before or is_refused:
            self.expect_silence()
        if is_refused or self.control.commanded.arming.state == "disarmed":
            self.ended_s = self.now_s

    def probe(self) -> None:
        if self.is_well and self.now_s - self.asked_s >= PROBE_S:
            self.asked_s = self.now_s
            self.hearing.prove(round((self.now_s - TICK_S) * 1e9), round(self.now_s * 1e9))

    def expect_silence(self) -> None:
        since = [self.ended_s, *(at_s for at_s in self.heard if at_s > self.ended_s)]
        assert not math.isfinite(self.ended_s) or np.diff(since).max(initial=0.0) > NEEDED_S


Goes = Callable[[OneWhoDoesNotLetGo], None]
TestOneWhoDoesNotLetGo = OneWhoDoesNotLetGo.TestCase
TestOneWhoDoesNotLetGo.settings = settings(max_examples=examples(100), stateful_step_count=30, deadline=None)


def stopped_in_motion() -> OneWhoDoesNotLetGo:
    run = OneWhoDoesNotLetGo()
    run.begin(is_simulated=True)
    run.drive(50)
    run.stop()
    run.drive(10)
    return run


@pytest.mark.parametrize("hole_s", [0.2, 0.32, 5.0])
def test_a_hole_in_the_stream_while_stopped_is_not_letting_go(hole_s: float) -> None:
    run = stopped_in_motion()
    run.a_hole(round(hole_s / TICK_S))
    run.reset(then_arm=False)
    run.drive(200)
    assert run.control.commanded.gate.state == "waiting"
    assert run.control.commanded.gate.reason == "there was a stop; let go, then engage anew"
    assert len(run.arm.engaged_at) == 1


def test_a_reset_that_arms_at_once_does_not_spare_the_silence() -> None:
    run = stopped_in_motion()
    run.arm.is_simulated = False
    run.a_hole(100)
    run.reset(then_arm=True)
    run.drive(200)
    assert run.control.commanded.arming.state == "armed"
    assert len(run.arm.engaged_at) == 1
    run.begins_anew()
    assert len(run.arm.engaged_at) == 2


def nonsense(run: OneWhoDoesNotLetGo) -> None:
    run.garbage(100, b"[NaN,0,0,0,0,0,0]")


def rival(run: OneWhoDoesNotLetGo) -> None:
    run.a_rival(100)


def stall(run: OneWhoDoesNotLetGo) -> None:
    run.stalled(300)


def freeze_shortly(run: OneWhoDoesNotLetGo) -> None:
    run.frozen(ticks=82, then=0)  # 0.33 s


def freeze(run: OneWhoDoesNotLetGo) -> None:
    run.frozen(ticks=600, then=20)


def cut(run: OneWhoDoesNotLetGo) -> None:
    run.cut_off(ticks=600, then=20, finds=True)


@pytest.mark.parametrize("goes_on", [freeze_shortly, freeze, cut])
def test_what_a_bus_that_is_frozen_or_cut_kept_from_us_is_no_silence(goes_on: Goes) -> None:
    run = stopped_in_motion()
    run.reset(then_arm=False)
    run.drive(5)
    for _ in range(3):
        goes_on(run)
    run.drive(50)
    assert len(run.arm.engaged_at) == 1
    run.begins_anew()
    assert len(run.arm.engaged_at) == 2


@pytest.mark.parametrize("goes_on", [nonsense, rival, stall])
def test_commands_that_are_refused_and_those_that_came_in_a_stall_are_no_silence(goes_on: Goes) -> None:
    run = stopped_in_motion()
    run.reset(then_arm=False)
    goes_on(run)
    run.drive(50)
    assert len(run.arm.engaged_at) == 1
