"""An arm and its command: sent where it moved, held when it is silent, released by stop, fault and disarming."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.control.arm_bench import FORMAT, Bench
from tests.control.ideal_arm import TICK_S


def test_while_nobody_commands_nothing_is_sent_and_what_is_used_is_where_the_arm_is() -> None:
    bench = Bench()
    record = bench.steps(1.0)
    assert record.decision.state == "waiting"
    np.testing.assert_array_equal(record.decision.vector, bench.arm.q)
    np.testing.assert_array_equal(record.target, bench.arm.q)
    assert (bench.arm.sent, bench.arm.engaged_at) == ([], [])


def test_a_command_that_moves_is_sent_in_every_tick_and_one_that_stays_in_none() -> None:
    bench = Bench()
    command = bench.drive(100)
    assert len(bench.arm.sent) == 100
    record = bench.steps(1.0, command)
    assert len(bench.arm.sent) == 100
    assert record.decision.state == "tracking"
    assert not record.is_sent
    np.testing.assert_array_equal(bench.arm.q, command)


def test_the_first_command_where_the_arm_is_sends_nothing() -> None:
    bench = Bench()
    bench.steps(0.1, bench.arm.q.copy())
    assert len(bench.arm.engaged_at) == 1
    assert bench.arm.sent == []


def test_a_silent_commander_is_held_after_100_ms_and_the_arm_is_nobodys_after_300_ms() -> None:
    bench = Bench()
    command = bench.drive(50)
    assert bench.steps(0.096).decision.state == "tracking"
    assert bench.steps(0.1).decision.state == "holding"
    assert bench.arm.is_engaged
    assert bench.steps(0.2).decision.state == "waiting"
    assert not bench.arm.is_engaged
    np.testing.assert_array_equal(bench.arm.q, command)
    assert len(bench.arm.sent) == 50


def test_a_commander_that_comes_back_within_300_ms_goes_on() -> None:
    bench = Bench()
    command = bench.drive(50)
    bench.steps(0.2)
    bench.drive(10, command)
    assert bench.state == "tracking"
    assert len(bench.arm.engaged_at) == 1


def test_a_command_far_away_is_approached_at_the_greatest_speed_and_never_far_ahead_of_the_arm() -> None:
    bench = Bench()
    far = bench.arm.q + np.array([0.5, 0, 0, 0, 0, 0, 0])
    ahead = []
    for _ in range(700):
        before = bench.arm.q
        bench.step(far)
        ahead.append(np.abs(bench.arm.goal - before).max())
    assert max(ahead) <= bench.arm.lead_rad + bench.arm.speed_rad_s * TICK_S + 1e-12
    np.testing.assert_allclose(bench.arm.q, far, atol=1e-12)
    assert "command-slewed" in bench.names()


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (b"[0,0,0]", "wrong-length"),
        (b"[NaN,0,0,0,0,0,0]", "not-finite"),
        (b"[9,0,0,0,0,0,0]", "out-of-range"),
        (b"hello", "not-json"),
    ],
)
def test_what_is_no_command_is_refused_and_moves_nothing(value: bytes, kind: str) -> None:
    bench = Bench()
    bench.drive(20)
    sent = len(bench.arm.sent)
    bench.step(value)
    assert bench.control.commanded.validator.refused[kind] == 1
    bench.steps(0.5)
    assert len(bench.arm.sent) == sent


def test_a_target_beyond_the_soft_limit_is_clipped_to_it() -> None:
    bench = Bench()
    bench.arm.q = bench.arm.goal = FORMAT.upper - 0.01
    bench.steps(1.0, FORMAT.upper + 0.1)
    np.testing.assert_allclose(bench.arm.q, FORMAT.upper, atol=1e-12)


def test_an_arm_beyond_its_soft_limit_comes_back_without_a_jump() -> None:
    bench = Bench()
    bench.arm.q = bench.arm.goal = FORMAT.upper + 0.02
    record = bench.step(FORMAT.upper)
    assert np.abs(record.decision.vector - (FORMAT.upper + 0.02)).max() <= FORMAT.rate[0] * TICK_S + 1e-12


def test_an_emergency_stop_releases_at_once_and_is_latched() -> None:
    bench = Bench()
    command = bench.drive(50)
    bench.control.stop("hand on the button")
    assert not bench.arm.is_engaged
    sent = len(bench.arm.sent)
    bench.drive(50, command)
    assert bench.state == "stopped"
    assert len(bench.arm.sent) == sent


def fault(bench: Bench) -> None:
    bench.arm.fault = "safety 1010: torque deviation"


def stop(bench: Bench) -> None:
    bench.control.stop("hand on the button")


def leave(bench: Bench) -> None:
    bench.arm.clear()
    bench.control.cleared("somebody")
    bench.control.reset("somebody")


@pytest.mark.parametrize("end", [stop, fault])
def test_after_a_stop_or_a_fault_who_never_let_go_is_not_followed(end: object) -> None:
    bench = Bench()
    command = bench.drive(50)
    assert callable(end)
    end(bench)
    command = bench.drive(20, command)
    sent, rested = len(bench.arm.sent), bench.arm.q
    leave(bench)
    command = bench.drive(100, command)
    assert bench.state == "waiting"
    assert len(bench.arm.sent) == sent
    bench.steps(0.4)
    bench.step(bench.arm.q.copy())
    assert bench.state == "tracking"
    np.testing.assert_array_equal(bench.arm.engaged_at[-1], bench.arm.q)
    np.testing.assert_allclose(bench.arm.q, rested, atol=bench.arm.lead_rad)


def test_a_fault_disengages_and_stays_until_it_is_cleared_even_when_the_controller_forgets_it() -> None:
    bench = Bench()
    bench.drive(50)
    fault(bench)
    bench.step()
    assert not bench.arm.is_engaged
    assert bench.names().count("controller-fault") == 1
    bench.arm.fault = ""
    record = bench.steps(1.0)
    assert record.decision.state == "faulted"
    assert record.decision.reason == "safety 1010: torque deviation"
    bench.control.cleared("somebody")
    assert bench.step().decision.state == "waiting"


def test_what_the_controller_says_of_its_fault_now_is_the_reason_and_each_text_is_told_once() -> None:
    bench = Bench()
    bench.drive(50)
    halted, waits = "safety 1010; when its cause is gone: clear it", "safety 1010; confirm it at the controller"
    for _ in range(20):
        for text in (halted, waits):
            bench.arm.fault = text
            assert bench.step().decision.reason == text
            assert text in bench.control.arm(bench.now_s, "somebody")
    bench.arm.fault = ""
    assert bench.step().decision.reason == waits
    told = [step_event.detail["reason"] for step_event in bench.told if step_event.name == "controller-fault"]
    assert told == [halted, waits]
    assert [step_event.detail["to"] for step_event in bench.told if step_event.name == "gate"].count("faulted") == 1
    bench.control.cleared("somebody")
    bench.arm.fault = halted
    bench.steps(0.1)
    assert bench.names().count("controller-fault") == 3, "a fault that comes again is told again"


def test_a_fault_whose_text_runs_does_not_flood_and_one_under_a_stop_is_told_once_the_stop_is_left() -> None:
    bench = Bench()
    for number in range(200):
        bench.arm.fault = f"halted {number} ms ago"
        bench.step()
    assert bench.state == "faulted"
    assert bench.control.commanded.gate.reason == "halted 199 ms ago"
    assert bench.names().count("controller-fault") == 16
    bench.control.stop("hand on the button")
    bench.arm.fault = "another"
    assert bench.step().decision.reason == "hand on the button"
    bench.control.reset("somebody")
    assert bench.step().decision.reason == "another"
    assert bench.names().count("controller-fault") == 17


def test_a_stop_is_more_than_a_fault_and_a_fault_that_is_still_there_shows_again() -> None:
    bench = Bench()
    fault(bench)
    bench.step()
    bench.control.stop("hand on the button")
    assert bench.step().decision.state == "stopped"
    bench.control.cleared("somebody")
    assert bench.step().decision.state == "stopped"
    bench.control.reset("somebody")
    assert bench.step().decision.state == "faulted"


def test_a_disarmed_arm_is_sent_nothing_and_arming_asks_for_a_command_that_begins_anew() -> None:
    bench = Bench(is_armed=False)
    command = bench.drive(50)
    assert bench.arm.engaged_at == []
    assert bench.control.arm(bench.now_s, "somebody") == ""
    command = bench.drive(100, command)
    assert bench.control.commanded.arming.state == "armed"
    assert bench.arm.engaged_at == []
    bench.steps(0.4)
    bench.drive(10)
    assert len(bench.arm.sent) == 10


def test_disarming_in_motion_releases_at_once() -> None:
    bench = Bench()
    bench.drive(50)
    bench.control.disarm("somebody")
    assert not bench.arm.is_engaged


def test_disarming_and_arming_between_two_ticks_does_not_spare_the_silence() -> None:
    bench = Bench()
    command = bench.drive(50)
    bench.control.disarm("somebody")
    assert bench.control.arm(bench.now_s, "somebody") == ""
    command = bench.drive(100, command)
    assert (bench.state, len(bench.arm.engaged_at)) == ("waiting", 1)
    bench.steps(0.4)
    bench.drive(10)
    assert (bench.state, len(bench.arm.engaged_at)) == ("tracking", 2)


@pytest.mark.parametrize("end", [stop, fault])
def test_arming_is_refused_while_stopped_or_faulted(end: object) -> None:
    bench = Bench(is_armed=False)
    assert callable(end)
    end(bench)
    bench.step()
    assert bench.control.arm(bench.now_s, "somebody")
    assert bench.control.commanded.arming.state == "disarmed"


def test_a_real_arm_is_disarmed_after_a_stop_whatever_it_started_as() -> None:
    bench = Bench()
    bench.arm.is_simulated = False
    bench.control.stop("hand on the button")
    bench.control.reset("somebody")
    assert bench.control.commanded.arming.state == "disarmed"


def test_an_arm_that_still_moves_is_not_engaged() -> None:
    bench = Bench()
    bench.arm.goal = bench.arm.q + 0.01
    record = bench.step(bench.arm.q.copy())
    assert record.decision.reason == "the arm still moves"
    assert bench.arm.engaged_at == []
    record = bench.steps(0.1, bench.arm.goal)
    assert record.decision.state == "tracking"


def test_the_record_lets_the_gate_be_asked_again_with_the_very_same_instant() -> None:
    bench = Bench()
    bench.now_s = 12345.678901234567
    record = bench.step(bench.arm.q.copy())
    assert record.timing_ns[3] == round(bench.now_s * 1e9)
    assert math.isclose(record.decision.age_s, 0.0, abs_tol=1e-9)
    assert record.command_seq == 1
