"""The gate, as a table of its transitions and as properties that hold for any history of commands."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.control.gate import Decision, Gate, GateConfig
from station.protocols import Floats

DT = 0.02
DEFAULT = np.array([0.0, 1.0])
COMMAND = np.array([2.0, -1.0])


class Run:
    """A gate and a commander that writes now and then."""

    def __init__(self, config: GateConfig | None = None) -> None:
        self.gate = Gate(DEFAULT, config)
        self.tick = 0
        self.command: Floats | None = None
        self.written_s = -math.inf

    @property
    def now_s(self) -> float:
        return self.tick * DT

    def step(self, command: Floats | None = None, *, refusal: str = "") -> Decision:
        self.tick += 1
        if command is not None:
            self.command, self.written_s = command, self.now_s
        return self.gate.step(self.now_s, self.command, self.now_s - self.written_s, refusal=refusal)

    def steps(self, count: int, command: Floats | None = None) -> list[Decision]:
        return [self.step(command) for _ in range(count)]

    def tracking(self) -> Run:
        self.steps(51, COMMAND)
        assert self.gate.state == "tracking"
        return self


def _names(decisions: list[Decision]) -> list[str]:
    return [change.after for decision in decisions for change in decision.transitions]


def test_without_a_command_it_waits_and_asks_the_robot_to_stand() -> None:
    decision = Run().step()
    assert (decision.state, decision.reason) == ("waiting", "no command yet")
    np.testing.assert_array_equal(decision.vector, DEFAULT)


def test_a_command_that_was_there_before_we_looked_moves_nothing() -> None:
    gate = Gate(DEFAULT)
    decision = gate.step(0.0, COMMAND, math.inf)
    assert decision.state == "waiting"
    np.testing.assert_array_equal(decision.vector, DEFAULT)


def test_a_command_that_seems_to_come_from_the_future_has_no_known_age_and_moves_nothing() -> None:
    gate = Gate(DEFAULT)
    assert gate.step(0.0, COMMAND, -0.5).state == "waiting"
    assert gate.step(0.02, COMMAND, -0.01).state == "entering", "the clock may be read just before it arrives"


def test_the_first_command_is_entered_over_one_second_and_then_tracked() -> None:
    run = Run()
    decisions = run.steps(51, COMMAND)
    assert _names(decisions) == ["entering", "tracking"]
    np.testing.assert_array_equal(decisions[0].vector, DEFAULT)
    np.testing.assert_allclose(decisions[25].vector, (DEFAULT + COMMAND) / 2)
    np.testing.assert_array_equal(decisions[50].vector, COMMAND)
    assert decisions[49].state == "entering"
    assert decisions[50].state == "tracking"


def test_the_blend_leads_to_the_live_command_so_that_nothing_jumps_when_it_ends() -> None:
    run, before = Run(), None
    for tick in range(120):
        vector = run.step(np.array([tick * DT, 0.0])).vector
        if before is not None:
            assert np.abs(vector - before).max() < 0.07
        before = vector


def test_a_command_older_than_100_ms_is_held() -> None:
    run = Run().tracking()
    decisions = run.steps(15)
    assert [d.state for d in decisions] == ["tracking"] * 5 + ["holding"] * 10
    for decision in decisions:
        np.testing.assert_array_equal(decision.vector, COMMAND)
    assert decisions[5].transitions[0].reason == "the newest good command is 120 ms old"


def test_a_command_older_than_300_ms_takes_the_robot_back_to_standing_within_two_seconds() -> None:
    run = Run().tracking()
    decisions = run.steps(130)
    assert _names(decisions) == ["holding", "returning", "waiting"]
    states = [d.state for d in decisions]
    assert states.index("returning") == 15
    assert states.index("waiting") == 115
    np.testing.assert_allclose(decisions[65].vector, (DEFAULT + COMMAND) / 2, atol=1e-12)
    np.testing.assert_array_equal(decisions[115].vector, DEFAULT)
    assert decisions[129].reason == "standing again"


def test_a_command_that_comes_back_while_holding_is_followed_at_once() -> None:
    run = Run().tracking()
    run.steps(10)
    decision = run.step(COMMAND + 0.1)
    assert decision.state == "tracking"
    np.testing.assert_array_equal(decision.vector, COMMAND + 0.1)


@pytest.mark.parametrize("silence", [20, 60, 100])
def test_a_command_that_comes_back_while_returning_is_entered_from_the_present_output(silence: int) -> None:
    run = Run().tracking()
    before = run.steps(silence)[-1]
    assert before.state == "returning"
    first, *others = run.steps(51, COMMAND)
    assert first.state == "entering"
    np.testing.assert_array_equal(first.vector, before.vector)
    assert others[-1].state == "tracking"


def test_a_blend_that_was_broken_off_is_begun_again_and_not_jumped_over() -> None:
    run = Run()
    run.steps(25, COMMAND)
    held = run.steps(8)[-1]
    assert held.state == "holding"
    back = run.step(COMMAND)
    assert back.state == "entering"
    np.testing.assert_array_equal(back.vector, held.vector)


def test_refused_commands_are_no_commands_and_the_reason_is_said() -> None:
    run = Run().tracking()
    decisions = [run.step(refusal="not-finite: element 3 is nan") for _ in range(6)]
    assert decisions[-1].state == "holding"
    assert decisions[-1].reason == "not-finite: element 3 is nan"
    waiting = Run().step(refusal="wrong-length: 3 values, expected 35")
    assert (waiting.state, waiting.reason) == ("waiting", "wrong-length: 3 values, expected 35")


def test_the_stop_is_latched_and_only_a_reset_leaves_it() -> None:
    run = Run().tracking()
    run.gate.stop("the operator pressed the button")
    decisions = run.steps(200, COMMAND)
    assert {d.state for d in decisions} == {"stopped"}
    assert decisions[0].transitions[0].reason == "the operator pressed the button"
    run.gate.reset()
    first = run.step()
    assert first.transitions[0].after == "waiting"


def test_a_command_that_runs_on_through_a_stop_is_not_followed_until_it_has_ceased_and_begun_anew() -> None:
    run = Run().tracking()
    run.gate.stop("the operator pressed the button")
    run.steps(5, COMMAND)
    run.gate.reset()
    ran_on = run.steps(200, COMMAND)
    assert {decision.state for decision in ran_on} == {"waiting"}
    assert ran_on[-1].reason == "there was a stop; let go, then engage anew"
    np.testing.assert_array_equal(ran_on[-1].vector, DEFAULT)
    run.steps(10)
    assert run.step(COMMAND).state == "waiting", "0.2 s without a command is no silence yet"
    run.steps(17)
    assert run.steps(2, COMMAND)[-1].state == "entering"


def test_a_second_stop_changes_nothing() -> None:
    run = Run()
    run.gate.stop("one")
    run.gate.stop("two")
    decision = run.step()
    assert [change.reason for change in decision.transitions] == ["one"]


def test_a_vector_given_out_does_not_change_later() -> None:
    run = Run()
    decisions = run.steps(60, COMMAND)
    decisions[0].vector[:] = 99.0
    np.testing.assert_array_equal(run.gate.step(9.0, None, math.inf).vector, COMMAND)


@pytest.mark.parametrize("name", ["blend_in_s", "hold_after_s", "return_after_s", "blend_out_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_time_that_is_not_positive_and_finite_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        GateConfig(**{name: value})  # type: ignore[arg-type]  # all that are given here are numbers


def test_returning_before_holding_is_refused() -> None:
    with pytest.raises(ValueError, match="must not be less than hold_after_s"):
        GateConfig(hold_after_s=0.5, return_after_s=0.2)


# -- properties over any history ---------------------------------------------------------------------------------

_numbers = st.floats(-3.0, 3.0)
_ticks = st.one_of(
    st.tuples(st.just("write"), _numbers, _numbers),
    st.tuples(st.just("bad"), st.sampled_from([math.nan, math.inf, -math.inf]), _numbers),
    st.just(("silence", 0.0, 0.0)),
    st.just(("stop", 0.0, 0.0)),
    st.just(("reset", 0.0, 0.0)),
)
_bursts = st.lists(st.tuples(_ticks, st.integers(1, 60)), min_size=1, max_size=25)


def _play(bursts: list[tuple[tuple[str, float, float], int]]) -> list[tuple[str, Floats | None, Decision, Decision]]:
    """Run a history; return (what happened, live command, decision before, decision after) of each tick."""
    run = Run()
    before = run.step()
    seen = []
    for (what, x, y), count in bursts:
        for _ in range(count):
            if what == "stop":
                run.gate.stop("stop")
            elif what == "reset":
                run.gate.reset()
            after = run.step(np.array([x, y]) if what in ("write", "bad") else None)
            seen.append((what, run.command, before, after))
            before = after
    return seen


@given(_bursts)
def test_the_output_is_always_finite_and_within_what_was_asked_for(
    bursts: list[tuple[tuple[str, float, float], int]],
) -> None:
    for _, _, _, after in _play(bursts):
        assert np.isfinite(after.vector).all()
        assert (np.abs(after.vector) <= 3.0 + 1e-9).all()


@given(_bursts)
def test_in_a_blend_no_tick_moves_the_output_by_more_than_its_share(
    bursts: list[tuple[tuple[str, float, float], int]],
) -> None:
    live_before = None
    for what, live, before, after in _play(bursts):
        moved = np.abs(after.vector - before.vector).max() if what != "reset" else 0.0
        if after.state == "entering" and before.state == "entering" and live is not None and live_before is not None:
            assert moved <= 6.0 * DT / 1.0 + np.abs(live - live_before).max() + 1e-9
        if after.state == "returning":
            assert moved <= 6.0 * DT / 2.0 + 1e-9
        if after.state in ("holding", "stopped"):
            assert moved == 0.0
        live_before = live


@given(_bursts)
def test_tracking_is_reached_only_through_a_whole_blend(bursts: list[tuple[tuple[str, float, float], int]]) -> None:
    entering_since = None
    for tick, (_, _, before, after) in enumerate(_play(bursts)):
        for change in after.transitions:
            if change.after == "entering":
                entering_since = tick
            if change.after == "tracking" and change.before == "entering":
                assert entering_since is not None
                assert (tick - entering_since) * DT >= 1.0 - 1e-9
        if after.state == "tracking":
            assert before.state in ("tracking", "entering", "holding")


@given(_bursts, st.integers(0, 40))
def test_two_and_a_third_seconds_after_the_last_good_command_the_robot_is_asked_to_stand(
    bursts: list[tuple[tuple[str, float, float], int]], bad: int
) -> None:
    history = [*bursts, (("write", 1.0, 1.0), 1), (("bad", math.nan, 0.0), bad or 1), (("silence", 0.0, 0.0), 125)]
    *_, (_, _, _, last) = _play(history)
    if last.state == "stopped":
        return
    assert last.state == "waiting"
    np.testing.assert_array_equal(last.vector, DEFAULT)


@given(_bursts)
def test_the_stop_is_left_only_by_a_reset(bursts: list[tuple[tuple[str, float, float], int]]) -> None:
    for what, _, before, after in _play(bursts):
        if before.state == "stopped" and what != "reset":
            assert after.state == "stopped"
        if what == "stop":
            assert after.state == "stopped"


@given(_bursts)
def test_the_transitions_told_are_the_changes_of_state(bursts: list[tuple[tuple[str, float, float], int]]) -> None:
    for _, _, before, after in _play(bursts):
        state = before.state
        for change in after.transitions:
            assert change.before == state
            assert change.after != state
            assert change.reason
            state = change.after
        assert state == after.state


@given(st.lists(st.tuples(_numbers, st.floats(allow_nan=True, allow_infinity=True)), max_size=60))
def test_no_clock_and_no_age_however_odd_makes_an_output_that_is_not_finite(ticks: list[tuple[float, float]]) -> None:
    gate = Gate(DEFAULT)
    for now_s, age_s in ticks:
        decision = gate.step(now_s, COMMAND, age_s)
        assert np.isfinite(decision.vector).all()
        if math.isnan(age_s):
            assert decision.state in ("waiting", "returning")
