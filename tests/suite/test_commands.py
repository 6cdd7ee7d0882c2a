"""Sources of commands: streams that break off, and arms that go anywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29, select
from station import registry
from station.contract import elements
from station.control.gate import Gate
from station.errors import ConfigError
from station.protocols import CommandFormat, Floats, Motion
from station.suite import commands
from station.suite.cases import Silence
from station.suite.promise import SILENCES

PERIOD_S = 0.02
SPEEDS = {joint.name: joint.velocity_rad_s for joint in select(G1_29)}
FORMAT: CommandFormat = registry.find("command", "twist2")
ARMS = np.array([6 + k for k, name in enumerate(G1_29) if any(w in name for w in ("shoulder", "elbow", "wrist"))])


@pytest.fixture(scope="module")
def walk() -> Motion:
    motion: Motion = registry.find("loader", "motion")("builtin:walk-forward")
    return motion


def stream(source: commands.Commands, seconds: float) -> list[Floats | None]:
    return [source(tick * PERIOD_S) for tick in range(round(seconds / PERIOD_S))]


def asked(motion: Motion, time_s: float) -> Floats:
    return FORMAT.encode(motion.at(time_s), motion.joint_names)


@pytest.mark.parametrize(("goes_on", "back_at_s"), [(True, 4.0), (False, 3.0)])
def test_a_stream_that_breaks_off_comes_back_where_the_motion_is_by_then(
    walk: Motion, goes_on: bool, back_at_s: float
) -> None:
    quiet = Silence("returning", 1.0, goes_on)
    sent = stream(commands.cut(walk, FORMAT, quiet, enter_s=2.0, at_s=3.0, lead_s=0.02), 4.0)
    heard = [tick for tick, command in enumerate(sent) if command is not None]
    assert heard == [*range(100), *range(150, 200)], "two seconds, a second of silence, and on"
    for tick, time_s in ((0, 1.0), (99, 2.98), (150, back_at_s), (199, back_at_s + 0.98)):
        np.testing.assert_allclose(sent[tick], asked(walk, time_s + 0.02), atol=1e-9)


def test_after_the_end_of_the_motion_nothing_comes(walk: Motion) -> None:
    at_s = walk.duration_s - 0.5
    source = commands.cut(walk, FORMAT, SILENCES[0], enter_s=0.5, at_s=at_s, lead_s=0.02)
    sent = stream(source, 3.0)
    assert sent[-1] is None
    assert sum(command is not None for command in sent) == pytest.approx(25 + 15, abs=1)


@pytest.mark.parametrize("silence", SILENCES, ids=lambda silence: silence.name)
def test_the_gate_goes_through_what_a_silence_is_named_after(walk: Motion, silence: Silence) -> None:
    source = commands.cut(walk, FORMAT, silence, enter_s=2.0, at_s=3.0, lead_s=0.02)
    gate, last, heard_s, states = Gate(FORMAT.default), None, -np.inf, []
    for tick in range(round((2.0 + silence.seconds + 2.0) / PERIOD_S)):
        now_s = tick * PERIOD_S
        command = source(now_s)
        if command is not None:
            last, heard_s = command, now_s
        states.append(gate.step(now_s, last, now_s - heard_s).state)
    back = 100 + round(silence.seconds / PERIOD_S)
    expected = {"holding": "holding", "returning": "returning", "standing": "waiting"}
    assert states[99] == "tracking"
    assert states[back - 1] == expected[silence.name]
    assert states[-1] == "tracking"


def test_a_clip_under_pushes_plays_again_and_again() -> None:
    motion = registry.find("loader", "motion")("builtin:wave")
    sent = np.array(stream(commands.playing_on(motion, FORMAT, period_s=PERIOD_S), 2.5 * motion.duration_s))
    elbow = sent[:, 6 + G1_29.index("right_elbow")]
    lows = np.flatnonzero(elbow < elbow.min() + 0.05) * PERIOD_S
    assert lows.max() - lows.min() > motion.duration_s
    assert np.abs(np.diff(sent, axis=0)).max() < 0.3, "without a jump"


def test_arms_go_anywhere_within_their_ranges_and_nothing_else_moves() -> None:
    sent = np.array(stream(commands.RandomArms(FORMAT, SPEEDS, 3), 600.0))
    rest = np.setdiff1d(np.arange(len(FORMAT.default)), ARMS)
    np.testing.assert_array_equal(sent[:, rest], np.tile(FORMAT.default[rest], (len(sent), 1)))
    arms, lower, upper = sent[:, ARMS], FORMAT.lower[ARMS], FORMAT.upper[ARMS]
    assert (arms >= lower - 1e-9).all()
    assert (arms <= upper + 1e-9).all()
    reached = (arms.max(axis=0) - arms.min(axis=0)) / (upper - lower)
    assert (reached > 0.95).all()


def test_arms_are_quick_and_slow_but_never_beyond_what_their_motors_can() -> None:
    sent = np.array(stream(commands.RandomArms(FORMAT, SPEEDS, 4), 300.0))[:, ARMS]
    speeds = np.abs(np.diff(sent, axis=0)) / PERIOD_S
    limits = np.array([SPEEDS[G1_29[element - 6]] for element in ARMS])
    assert (speeds.max(axis=0) <= 0.8 * limits + 1e-6).all()
    assert (speeds.max(axis=0) > 0.3 * limits).all()
    assert np.median(speeds) < 1.5


def test_a_seed_gives_the_same_arms_every_time_and_another_gives_others() -> None:
    first, again, other = (np.array(stream(commands.RandomArms(FORMAT, SPEEDS, seed), 5.0)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_arms_need_a_format_with_arms_and_a_robot_that_knows_its_speeds() -> None:
    with pytest.raises(ConfigError, match="no element is named after a shoulder, elbow or wrist"):
        commands.RandomArms(replace(FORMAT, elements=elements((("joint_1_pos",), "rad"))), SPEEDS, 1)  # type: ignore[type-var]
    with pytest.raises(ConfigError, match="left_shoulder_pitch"):
        commands.RandomArms(FORMAT, {}, 1)
