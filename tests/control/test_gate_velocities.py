"""Where commands are lost, velocities fade at once; heights, leans and joints are held and blended as ever."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station import registry
from station.bus import contracts
from station.control.gate import Bounds, Decision, Gate, GateConfig
from station.protocols import CommandFormat, Floats
from tests.examples import examples

DT = 0.02
ROUNDING = 1e-9
FORMATS: dict[str, CommandFormat] = {name: registry.find("command", name) for name in ("twist2", "twist")}
FORMAT = FORMATS["twist2"]
VELOCITIES = list(FORMAT.velocities)
POSES = [index for index in range(len(FORMAT.default)) if index not in VELOCITIES]
WALKING = FORMAT.default + 0.1
WALKING[VELOCITIES] = 0.9, -0.2, 0.5


def gate(config: GateConfig | None = None, *, fades: bool = True) -> Gate:
    config = config or GateConfig()
    bounds = Bounds.of(FORMAT, config.rate_factor)
    return Gate(FORMAT.default, config, bounds, velocities=FORMAT.velocities if fades else ())


class Walk:
    """A gate that tracks a walk from tick 0 on, and how its commands end and come back."""

    def __init__(self, config: GateConfig | None = None) -> None:
        self.gate, self.tick, self.written = gate(config), 0, 0
        self.steps(60, WALKING)
        assert self.gate.state == "tracking"

    def step(self, command: Floats | None = None) -> Decision:
        self.tick += 1
        if command is not None:
            self.command, self.written = command, self.tick
        return self.gate.step(self.tick * DT, self.command, (self.tick - self.written) * DT)

    def steps(self, count: int, command: Floats | None = None) -> list[Decision]:
        return [self.step(command) for _ in range(count)]


@pytest.mark.parametrize("command_format", FORMATS.values(), ids=FORMATS)
def test_every_element_in_metres_or_radians_per_second_is_declared_a_velocity(command_format: CommandFormat) -> None:
    contract = contracts.contract(command_format.key)
    assert contract is not None
    per_second = tuple(index for index, element in enumerate(contract.elements) if element.unit in ("m/s", "rad/s"))
    assert command_format.velocities == per_second
    assert len(per_second) == {"twist2": 3, "twist": 4}[command_format.name]
    assert not command_format.default[list(per_second)].any()


def test_velocities_are_zero_300_ms_after_the_last_command_and_fade_linearly_from_100_ms_on() -> None:
    walk = Walk()
    made = np.array([decision.vector for decision in walk.steps(120)])
    ages_s = DT * np.arange(1, 121)
    left = np.clip((0.3 - ages_s) / 0.2, 0.0, 1.0)
    np.testing.assert_allclose(made[:, VELOCITIES], left[:, None] * WALKING[VELOCITIES], atol=1e-12)
    assert not made[14:, VELOCITIES].any(), "exactly zero from 300 ms on"


def test_heights_leans_and_joints_keep_their_blends() -> None:
    walk, as_ever = Walk(), gate(fades=False)
    for tick in range(1, 61):
        as_ever.step(tick * DT, WALKING, 0.0)
    for silent in range(1, 130):
        expected = as_ever.step((60 + silent) * DT, WALKING, silent * DT)
        decision = walk.step()
        assert decision.state == expected.state
        np.testing.assert_array_equal(decision.vector[POSES], expected.vector[POSES])


@pytest.mark.parametrize("silence", [6, 10, 14, 15])
def test_commands_that_come_back_while_held_are_followed_at_once_and_their_velocities_within_200_ms(
    silence: int,
) -> None:
    walk = Walk()
    held = walk.steps(silence)[-1].vector
    live = WALKING.copy()
    live[POSES] += 0.01
    made = walk.steps(10, live)
    assert [decision.state for decision in made] == ["tracking"] * 10
    np.testing.assert_array_equal(made[0].vector[POSES], live[POSES])
    for number, decision in enumerate(made, start=1):
        back = held[VELOCITIES] + number / 10 * (live - held)[VELOCITIES]
        np.testing.assert_allclose(decision.vector[VELOCITIES], back, atol=1e-12)
    np.testing.assert_array_equal(made[-1].vector, live)


def test_commands_that_are_lost_again_while_they_come_back_fade_from_where_they_are() -> None:
    walk = Walk()
    walk.steps(13)
    back = walk.steps(3, WALKING)[-1].vector
    lost = walk.steps(15)
    assert not lost[-1].vector[VELOCITIES].any()
    assert (np.abs(lost[-1].vector[VELOCITIES]) <= np.abs(back[VELOCITIES])).all()


def test_commands_that_end_by_refusal_fade_without_a_hold() -> None:
    walk = Walk()
    made = [walk.gate.step((60 + tick) * DT, None, np.inf, refusal="not-json") for tick in range(1, 11)]
    assert {decision.state for decision in made} == {"returning"}
    assert not made[-1].vector[VELOCITIES].any()


def test_a_return_that_is_shorter_than_the_fade_ends_at_standing_too() -> None:
    walk = Walk(GateConfig(return_after_s=0.1, blend_out_s=0.1, rate_factor=100.0))
    decision = walk.steps(30)[-1]
    assert decision.state == "waiting"
    np.testing.assert_array_equal(decision.vector, FORMAT.default)


_histories = st.lists(
    st.tuples(st.sampled_from(["write", "write", "silence", "none", "stop", "reset", "other"]),
              st.integers(0, 99), st.integers(1, 40)),
    min_size=1, max_size=12,
)  # fmt: skip


@settings(max_examples=examples(200), deadline=None)
@given(_histories, st.sampled_from([1.0, 0.5, 3.0]))
def test_in_no_history_do_velocities_grow_unfollowed_outlive_200_ms_of_it_or_break_their_rate(
    history: list[tuple[str, int, int]], factor: float
) -> None:
    faded, as_ever = gate(GateConfig(rate_factor=factor)), gate(GateConfig(rate_factor=factor), fades=False)
    command, written_s, before, tick, unfollowed_s = FORMAT.default, -1.0, FORMAT.default, 0, 1.0
    for what, seed, ticks in history:
        for _ in range(ticks):
            tick += 1
            now_s = tick * DT
            if what in ("write", "other"):
                command = np.random.default_rng(seed).uniform(FORMAT.lower, FORMAT.upper)
                written_s = now_s
            for one in (faded, as_ever):
                if what == "stop":
                    one.stop("stop")
                elif what == "reset":
                    one.reset()
                elif what == "other":
                    one.change_hands("another commands")
            given_command = None if what == "none" else command
            expected = as_ever.step(now_s, given_command, now_s - written_s)
            decision = faded.step(now_s, given_command, now_s - written_s)
            moved, speeds = np.abs(decision.vector - before), np.abs(decision.vector[VELOCITIES])
            is_followed = decision.state in ("entering", "tracking")
            unfollowed_s = 0.0 if is_followed else unfollowed_s + DT
            np.testing.assert_array_equal(decision.vector[POSES], expected.vector[POSES])
            if what != "reset":
                assert (moved <= FORMAT.rate * factor * DT + ROUNDING).all()
            if not is_followed:
                assert (speeds <= np.abs(before[VELOCITIES])).all()
            if decision.state in ("holding", "returning") and unfollowed_s >= 0.2 - ROUNDING:
                assert not speeds.any()
            if decision.state == "waiting":
                np.testing.assert_array_equal(decision.vector, FORMAT.default)
            before = decision.vector
