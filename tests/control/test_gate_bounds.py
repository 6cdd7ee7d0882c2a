"""Nothing wild: whatever comes from writers and clocks, what leaves the gate is bounded in place, speed and time."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from adapters.motions import builtin
from station import registry
from station.bus import codec
from station.control.command_arbiter import CommandArbiter
from station.control.command_validator import CommandSample, CommandValidator
from station.control.gate import LONGEST_SLEW_TICK_S, Bounds, Decision, Gate, GateConfig
from station.errors import ConfigError
from station.life.writer_conflict import FOREIGN
from station.motion.playback import Playback
from station.protocols import CommandFormat, Floats, Motion
from tests.examples import examples, some

DT = 0.02
FORMATS: dict[str, CommandFormat] = {name: registry.find("command", name) for name in ("twist2", "twist")}
FORMAT = FORMATS["twist2"]
ROUNDING = 1e-9
LONGEST_S = 0.1  # what a tick counts for at most, where a clock leaps
LATE_S = LONGEST_S + 0.06  # the tick of a leap in which the return begins, two others, and the slack of an age


def bounded(command_format: CommandFormat = FORMAT, config: GateConfig | None = None) -> Gate:
    config = config or GateConfig()
    return Gate(
        command_format.default,
        config,
        Bounds.of(command_format, config.rate_factor),
        velocities=command_format.velocities,
    )


def end_to_end(seed: int, spread: float = 0.0) -> Floats:
    """A command anywhere within its ranges, or beyond them by a share of its margins."""
    random = np.random.default_rng(seed)
    ends = np.where(random.random(len(FORMAT.default)) < 0.5, FORMAT.lower, FORMAT.upper)
    anywhere = random.uniform(FORMAT.lower, FORMAT.upper)
    vector = np.where(random.random(len(FORMAT.default)) < 0.3, ends, anywhere)
    return np.asarray(vector + random.uniform(-spread, spread, len(vector)) * FORMAT.margin)


GARBAGE = (
    b"", b"hello", b"null", b"{}", b"[true]", b"[1, 2]", b"[" * 5000, b"\xff" * 40, json.dumps(["1"] * 35).encode(),
    json.dumps([math.nan] * 35).encode(), json.dumps([math.inf] * 35).encode(), json.dumps([1e300] * 35).encode(),
    json.dumps([0.0] * 36).encode(), json.dumps([[0.0]] * 35).encode(), b"[" + b"1e999," * 34 + b"1]",
)  # fmt: skip


class WritersAndClocks(RuleBasedStateMachine):
    """Writers, a clock, an operator, and what is asked of the gate in every tick."""

    @initialize(
        factor=st.sampled_from([1.0, 0.5, 3.0]),
        rivals=st.sampled_from(["keep-first", "newest"]),
        start_s=st.sampled_from([0.0, 12345.678, -5.0]),
    )
    def begin(self, factor: float, rivals: str, start_s: float) -> None:
        config = GateConfig(rate_factor=factor, rivals=rivals)  # type: ignore[arg-type]
        self.gate, self.validator = bounded(FORMAT, config), CommandValidator(FORMAT)
        self.writers = CommandArbiter(config.rivals, config.return_after_s)
        self.rate = np.minimum(FORMAT.rate * factor, 1e12)
        self.now_s = self.clock_s = start_s  # `clock_s` is the newest instant that was one
        self.sample: CommandSample | None = None
        self.before = FORMAT.default.copy()
        self.quiet_s = math.inf  # time that counts since the last good command was taken up
        self.is_stopped = self.is_reset = False

    # -- what comes ----------------------------------------------------------------------------------------------
    def send(self, value: bytes, writer: str, arrived_s: float | None) -> None:
        if self.writers.on_write(writer, self.now_s):
            self.sample = CommandSample(value, arrived_s, source=writer)

    who = st.sampled_from(["a.1.x.1", "b.2.x.2", FOREIGN])

    @rule(seed=st.integers(0, 2**32), spread=st.sampled_from([0.0, 0.9, 3.0]), writer=who, ticks=st.integers(1, 70))
    def jump(self, seed: int, spread: float, writer: str, ticks: int) -> None:
        for _ in range(ticks):  # the same far place, tick after tick
            self.send(codec.json_vector(end_to_end(seed, spread)), writer, self.now_s)
            self.tick()

    @rule(seed=st.integers(0, 2**32), ticks=st.integers(1, 60))
    def two_at_once(self, seed: int, ticks: int) -> None:
        for _ in range(ticks):
            self.send(codec.json_vector(end_to_end(seed)), "a.1.x.1", self.now_s)
            self.send(codec.json_vector(end_to_end(seed + 1)), "b.2.x.2", self.now_s)
            self.tick()

    @rule(seed=st.integers(0, 2**32), writer=who)
    def flood(self, seed: int, writer: str) -> None:
        for number in range(300):  # 5 kHz for three ticks
            self.send(codec.json_vector(end_to_end(seed + number % 7)), writer, self.now_s)
            if number % 100 == 99:
                self.tick()

    @rule(value=st.one_of(st.sampled_from(GARBAGE), st.binary(max_size=60)), writer=who, ticks=st.integers(1, 20))
    def garbage(self, value: bytes, writer: str, ticks: int) -> None:
        for _ in range(ticks):
            self.send(value, writer, self.now_s)
            self.tick()

    @rule(
        seed=st.integers(0, 2**32),
        arrived_s=st.one_of(st.none(), st.floats(), st.sampled_from([math.nan, math.inf, -math.inf, 1e9, -1e9])),
        ticks=st.integers(1, 130),
    )
    def of_odd_age(self, seed: int, arrived_s: float | None, ticks: int) -> None:
        self.send(codec.json_vector(end_to_end(seed)), "a.1.x.1", arrived_s)
        self.silence(ticks)

    @rule(ticks=st.integers(1, 140))
    def silence(self, ticks: int) -> None:
        for _ in range(ticks):
            self.tick()

    # -- clocks and operators ------------------------------------------------------------------------------------
    @rule(by_s=st.one_of(st.floats(-20.0, 20.0), st.sampled_from([-1e6, 1e6, -0.02, 0.3, 2.0])))
    def leap(self, by_s: float) -> None:
        self.now_s += by_s
        self.tick()

    @rule(seed=st.integers(0, 2**32), ticks=st.integers(1, 110), by_s=st.floats(-20.0, 20.0))
    def leap_on_the_way_home(self, seed: int, ticks: int, by_s: float) -> None:
        self.jump(seed=seed, spread=0.0, writer="a.1.x.1", ticks=60)
        self.silence(ticks=ticks)
        self.leap(by_s=by_s)
        self.silence(ticks=125)

    @rule(seed=st.integers(0, 2**32), by_s=st.floats(0.0, 0.2))
    def back_and_forth(self, seed: int, by_s: float) -> None:
        self.jump(seed=seed, spread=0.0, writer="a.1.x.1", ticks=60)
        for _ in range(140):  # a clock that runs two ticks and falls back by nearly as much
            self.tick()
            self.tick()
            self.now_s -= min(by_s, 1.9 * DT)

    @rule(odd_s=st.sampled_from([math.nan, math.inf, -math.inf, 1e300]))
    def no_instant(self, odd_s: float) -> None:
        self.check(self.step(odd_s), 0.0)

    @rule()
    def stop(self) -> None:
        self.gate.stop("stop")
        self.is_stopped = True

    @rule()
    def reset(self) -> None:
        self.gate.reset()
        self.is_stopped, self.is_reset = False, True

    # -- a tick, and what must hold ------------------------------------------------------------------------------
    def tick(self) -> None:
        self.now_s += DT
        passed_s = min(max(0.0, self.now_s - self.clock_s), LONGEST_S)
        self.clock_s = self.now_s
        self.check(self.step(self.now_s), passed_s)

    def step(self, now_s: float) -> Decision:
        validator, good = self.validator, self.validator.good
        validator.update(self.sample)
        if validator.good is not good:
            self.quiet_s = 0.0
            if good is not None and validator.good is not None and validator.good.source != good.source:
                self.gate.change_hands("another writer")
        refusal = "" if validator.refusal is None else validator.refusal.text
        return self.gate.step(now_s, validator.vector, validator.age_s(now_s), refusal=refusal)

    def check(self, decision: Decision, passed_s: float) -> None:
        vector = decision.vector
        assert np.isfinite(vector).all()
        assert (vector >= FORMAT.lower).all()
        assert (vector <= FORMAT.upper).all()
        if not self.is_reset:
            most = self.rate * min(passed_s, LONGEST_SLEW_TICK_S)
            assert (np.abs(vector - self.before) <= most + ROUNDING).all()
        assert (decision.state == "stopped") == self.is_stopped
        self.quiet_s += passed_s
        if self.quiet_s >= 0.3 + 2.0 + LATE_S and not self.is_stopped:
            assert decision.state == "waiting"
            np.testing.assert_array_equal(vector, FORMAT.default)
        self.before, self.is_reset = vector, False


TestWritersAndClocks = WritersAndClocks.TestCase
TestWritersAndClocks.settings = settings(max_examples=examples(60), stateful_step_count=25, deadline=None)


@given(
    st.lists(
        st.tuples(st.floats(), st.floats(), st.sampled_from(["far", "nan", "inf", "short", "none"]), st.integers(0, 9)),
        max_size=80,
    )
)
def test_the_gate_alone_is_bounded_for_any_clock_age_and_vector(ticks: list[tuple[float, float, str, int]]) -> None:
    gate, before = bounded(), FORMAT.default
    for now_s, age_s, kind, seed in ticks:
        command = {
            "far": end_to_end(seed, 50.0), "nan": np.full(35, math.nan), "inf": np.full(35, math.inf),
            "short": np.zeros(3), "none": None,
        }[kind]  # fmt: skip
        vector = gate.step(now_s, command, age_s).vector
        assert ((vector >= FORMAT.lower) & (vector <= FORMAT.upper)).all()
        assert (np.abs(vector - before) <= FORMAT.rate * LONGEST_SLEW_TICK_S + ROUNDING).all()
        before = vector


@given(
    st.integers(0, 2**32), st.integers(1, 200), st.sampled_from([0.3, 1.0, 10.0]), st.sampled_from([100.0, 50.0, 25.0])
)
def test_within_300_ms_and_2_s_of_the_last_good_command_the_robot_is_asked_to_stand_exactly(
    seed: int, ticks: int, factor: float, rate_hz: float
) -> None:
    gate, period_s = bounded(FORMAT, GateConfig(rate_factor=factor)), 1.0 / rate_hz
    for tick in range(ticks):
        gate.step(tick * period_s, end_to_end(seed + tick // 10), 0.0)
    last_s = (ticks - 1) * period_s
    for tick in range(ticks, ticks + math.floor((2.3 + 2 * period_s) * rate_hz + ROUNDING)):
        decision = gate.step(tick * period_s, end_to_end(seed), tick * period_s - last_s)
    assert decision.state == "waiting"
    np.testing.assert_array_equal(decision.vector, FORMAT.default)


def test_a_command_that_jumps_is_caught_up_with_at_the_speed_of_its_joints() -> None:
    gate, far = bounded(), FORMAT.default.copy()
    for tick in range(51):
        gate.step(tick * DT, FORMAT.default, 0.0)
    knee = 6 + 3
    far[knee] = FORMAT.upper[knee]
    vectors, limited = [FORMAT.default], []
    for tick in range(51, 60):
        decision = gate.step(tick * DT, far, 0.0)
        vectors.append(decision.vector)
        limited.append(decision.limited)
    needed = math.ceil((far[knee] - FORMAT.default[knee]) / (20.0 * DT))
    assert needed > 5
    assert limited == [(knee,)] * (needed - 1) + [()] * (len(limited) - needed + 1)
    np.testing.assert_array_equal(vectors[needed], far)
    assert np.diff(vectors, axis=0).max() <= 20.0 * DT + ROUNDING


def test_after_a_stall_nothing_moves_further_than_in_40_ms() -> None:
    moved = Bounds.of(FORMAT).step(FORMAT.default, FORMAT.upper, 1.0) - FORMAT.default
    np.testing.assert_allclose(moved, np.minimum(FORMAT.upper - FORMAT.default, FORMAT.rate * LONGEST_SLEW_TICK_S))
    assert LONGEST_SLEW_TICK_S <= 2 * DT


def test_another_writer_is_entered_from_the_present_output() -> None:
    gate, other = bounded(), end_to_end(7)
    for tick in range(60):
        held = gate.step(tick * DT, end_to_end(3), 0.0).vector
    gate.change_hands("b commands in place of a")
    first = gate.step(60 * DT, other, 0.0)
    assert (first.state, first.reason) == ("entering", "b commands in place of a")
    np.testing.assert_array_equal(first.vector, held)
    later = [gate.step(tick * DT, other, 0.0) for tick in range(61, 111)]
    assert [decision.state for decision in later] == ["entering"] * 49 + ["tracking"]
    np.testing.assert_array_equal(later[-1].vector, other)


def test_another_writer_in_the_middle_of_a_blend_is_given_a_whole_one() -> None:
    gate = bounded()
    for tick in range(30):
        held = gate.step(tick * DT, end_to_end(3), 0.0).vector
    gate.change_hands("b commands in place of a")
    made = [gate.step(tick * DT, end_to_end(7), 0.0) for tick in range(30, 81)]
    np.testing.assert_array_equal(made[0].vector, held)
    assert [decision.state for decision in made] == ["entering"] * 50 + ["tracking"]


def test_rates_so_low_that_the_robot_could_not_return_in_time_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"element \d+ needs more than blend_out_s .2 s. to return to standing"):
        bounded(FORMAT, GateConfig(rate_factor=0.05))
    with pytest.raises(ValueError, match="rate_factor must be a positive number"):
        GateConfig(rate_factor=0.0)


def passed_through(motion: Motion, command_format: CommandFormat, gate: Gate) -> list[Decision]:
    """What the gate makes of a motion, from the first blend to the last, as in lock-step."""
    playback, validator, made, tick = (
        Playback(motion, command_format, lead_s=DT),
        CommandValidator(command_format),
        [],
        0,
    )
    while not playback.is_done:
        frame = playback.step(DT if tick else 0.0)
        validator.update(CommandSample(codec.json_vector(frame.command), arrived_s=tick * DT))
        made.append(gate.step(tick * DT, validator.vector, validator.age_s(tick * DT)))
        tick += 1
    return made


def expect_unchanged(name: str, command_format: CommandFormat) -> None:
    motion = registry.find("loader", "motion")(name)
    free = passed_through(motion, command_format, Gate(command_format.default))
    made = passed_through(motion, command_format, bounded(command_format))
    assert not any(decision.limited for decision in made)
    np.testing.assert_array_equal([d.vector for d in made], [d.vector for d in free])


@pytest.mark.parametrize("command_format", FORMATS.values(), ids=FORMATS)
@pytest.mark.parametrize("name", some(builtin.names()))
def test_every_built_in_motion_passes_unchanged_to_the_last_bit(name: str, command_format: CommandFormat) -> None:
    expect_unchanged(f"builtin:{name}", command_format)


@pytest.mark.assets
@pytest.mark.parametrize("command_format", FORMATS.values(), ids=FORMATS)
@pytest.mark.parametrize("number", some(range(1, 7)))
def test_people_who_walk_pass_unchanged_to_the_last_bit(number: int, command_format: CommandFormat) -> None:
    expect_unchanged(f"twist2:motions/0807_yanjie_walk_00{number}.pkl", command_format)
