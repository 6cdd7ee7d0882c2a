"""The envelope: what is inside passes to the last bit, what is beyond comes back towards standing, and it is told."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station import assets, registry
from station.bus import codec
from station.control.arming import Arming
from station.control.command_path import CommandPath
from station.control.command_validator import CommandSample
from station.control.envelope import (
    MOST_BYTES,
    Envelope,
    EnvelopeLimit,
    Ranges,
    Span,
    found,
    from_stated,
    of_parts,
    read,
    stated,
)
from station.control.gate import Gate, GateConfig
from station.control.rig import RigConfig, build, expect
from station.errors import BadFile, ConfigError
from station.protocols import CommandFormat, Floats
from tests.examples import examples

FORMAT: CommandFormat = registry.find("command", "twist2")
CHECKPOINT = assets.resolve("builtin:tracker.onnx")
ENVELOPE = read(CHECKPOINT.with_name("tracker.envelope.yaml"))
STANDING = FORMAT.default
NAMES = [element.name for element in FORMAT.elements]
DT = 0.02
BOUNDED = [NAMES.index(name) for name in ENVELOPE.bounded.elements]
REACHING = [NAMES.index(name) for name in ENVELOPE.reaching.elements]
WEIGHTS = np.array(ENVELOPE.sums)
ENDS = {each.over_s: (np.array(each.lower), np.array(each.upper)) for each in ENVELOPE.spans if not each.is_change}


def share(sums: Floats, over_s: float) -> float:
    """How much of what sums may be is in use; 1 is all."""
    lower, upper = ENDS[over_s]
    return float(np.maximum(sums / lower, sums / upper).max())


def summed(vector: Floats) -> Floats:
    return np.asarray(WEIGHTS @ (vector - STANDING)[BOUNDED])


def anywhere(seed: int) -> Floats:
    random = np.random.default_rng(seed)
    ends = np.where(random.random(len(STANDING)) < 0.5, FORMAT.lower, FORMAT.upper)
    return np.where(random.random(len(STANDING)) < 0.3, ends, random.uniform(FORMAT.lower, FORMAT.upper))


def streamed(gate: Gate, commands: list[Floats]) -> list[Floats]:
    made = []
    for tick, command in enumerate(commands):
        decision = gate.step(tick * DT, command, 0.0)
        assert np.isfinite(decision.vector).all()
        made.append(decision.vector)
    return made


@settings(max_examples=examples(30), deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2**32), st.integers(1, 60)), min_size=1, max_size=12))
def test_whatever_is_commanded_every_tick_is_within_the_envelope(drawn: list[tuple[int, int]]) -> None:
    commands = [anywhere(seed) for seed, ticks in drawn for _ in range(ticks)]
    gate = Gate.of(FORMAT, GateConfig(blend_in_s=0.1), [ENVELOPE])
    rate = np.array(ENVELOPE.bounded.rate)
    made = streamed(gate, commands)
    for before, after in pairwise(made):
        assert share(summed(after), 0.0) <= 1.0 + 1e-6
        assert (np.abs(after - before)[BOUNDED] <= rate * DT + 1e-9).all()
    out = np.array(made)
    assert (out[:, BOUNDED] >= np.array(ENVELOPE.bounded.lower) - 1e-9).all()
    assert (out[:, BOUNDED] <= np.array(ENVELOPE.bounded.upper) + 1e-9).all()


def test_what_a_motion_asks_for_a_moment_is_not_held_for_seconds() -> None:
    gate = Gate.of(FORMAT, GateConfig(), [ENVELOPE])
    fast = STANDING.copy()
    fast[NAMES.index("root_vel_x")] = FORMAT.upper[NAMES.index("root_vel_x")]
    made = streamed(gate, [fast] * 500)
    speeds = np.array(made)[:, NAMES.index("root_vel_x")]
    assert speeds[-1] < 0.8 * speeds.max()
    used = []
    for over_s in (0.5, 2.0, 5.0):
        average = np.zeros(len(WEIGHTS))
        for vector in made:
            average += DT / over_s * (summed(vector) - average)
        used.append(share(average, over_s))
    assert 0.95 < max(used) < 1.01, "as much as it survives, and no more"


def test_arms_reach_as_far_as_the_format_while_the_robot_stands_and_not_while_it_walks_at_the_edge() -> None:
    arm = NAMES.index("left_shoulder_pitch_pos")
    out = STANDING.copy()
    out[arm] = FORMAT.lower[arm]
    gate = Gate.of(FORMAT, GateConfig(), [ENVELOPE])
    assert streamed(gate, [out] * 150)[-1][arm] == FORMAT.lower[arm]
    walking = out.copy()
    walking[NAMES.index("root_vel_x")] = 2.0
    made = streamed(Gate.of(FORMAT, GateConfig(), [ENVELOPE]), [out] * 150 + [walking] * 60)
    used = [share(summed(vector), 0.0) for vector in made[150:]]
    assert used[0] < 0.05, "legs wait for the arms"
    motions = ENVELOPE.reaching.lower[ENVELOPE.reaching.elements.index("left_shoulder_pitch_pos")]
    assert used[-1] > 0.5, "the arms make room"
    assert made[-1][arm] > motions - 0.5 * (motions - FORMAT.lower[arm])
    for vector in made[150:]:
        reach = (motions - vector[arm]) / (motions - FORMAT.lower[arm])
        assert max(reach, 0.0) + share(summed(vector), 0.0) <= 1.0 + 0.1, "one has the room that the other leaves"


def test_two_commands_that_are_survived_are_joined_by_a_straight_line() -> None:
    """Each element at its own pace would pass by one that is not survived."""
    limit = EnvelopeLimit(ENVELOPE, FORMAT)
    apart = [limit.limit(anywhere(seed), STANDING, 0.0) for seed in range(40)]
    worst = 0.0
    for one, other in pairwise(apart):
        gate = Gate.of(FORMAT, GateConfig(blend_in_s=DT), [ENVELOPE])
        for vector in streamed(gate, [one] * 40 + [other] * 6):
            worst = max(worst, share(summed(vector), 0.0))
    assert worst <= 1.0 + 1e-6


def test_a_pose_changes_as_a_whole_no_faster_than_a_motion_changes_it() -> None:
    """A knee moves faster in a step than two may together out of a squat."""
    (fast,) = [each for each in ENVELOPE.spans if each.is_change]
    motion = registry.find("loader", "motion")("builtin:squat")
    low = min((FORMAT.encode(motion.at(at_s), motion.joint_names) for at_s in np.arange(0.0, motion.duration_s, 0.1)),
              key=lambda vector: float(vector[NAMES.index("root_height")]))  # fmt: skip
    made = streamed(Gate.of(FORMAT, GateConfig(), [ENVELOPE]), [low] * 150 + [STANDING] * 60)
    average, used = np.zeros(len(WEIGHTS)), []
    for vector in made:
        average += DT / fast.over_s * (summed(vector) - average)
        change = summed(vector) - average
        used.append(float(np.maximum(change / fast.lower, change / fast.upper).max()))
    assert 0.95 < max(used[150:]) < 1.0 + 1e-6
    np.testing.assert_array_equal(made[-1], STANDING)
    alone = streamed(Gate.of(FORMAT, GateConfig()), [low] * 150 + [STANDING] * 60)
    assert (alone[160] == STANDING).all()
    assert made[160][NAMES.index("left_knee_pos")] > STANDING[NAMES.index("left_knee_pos")] + 0.1


def test_after_a_restore_averages_bound_nothing_until_the_robot_has_stood() -> None:
    gate = Gate.of(FORMAT, GateConfig(), [ENVELOPE])
    assert gate.knows_averages
    gate.restore(STANDING, 0.0)
    assert not gate.knows_averages
    for tick in range(1, 200):
        gate.step(tick * DT, None, np.inf)
    assert gate.state == "waiting"
    assert gate.knows_averages


def test_beyond_is_told_once_and_when_it_has_ended_and_counted_in_each_tick() -> None:
    path = CommandPath(FORMAT, GateConfig(), Arming(is_armed=True), envelopes=[ENVELOPE])
    low = STANDING.copy()
    low[NAMES.index("root_height")] = 0.2
    told: list[tuple[str, dict[str, Any]]] = []
    for tick in range(250):
        vector = low if tick < 150 else STANDING
        now_s = tick * DT
        decision = path.decide(CommandSample(codec.json_vector(vector), arrived_s=now_s), now_s)
        if tick == 100:
            assert path.status(decision)["beyond_envelope"] == len(decision.beyond) > 0
            assert decision.vector[NAMES.index("root_height")] > 0.35
        told += [(each.name, each.detail) for each in path.taken()]
    beyond = [detail for name, detail in told if name == "command-beyond-envelope"]
    assert len(beyond) == 2
    assert "root_height" in beyond[0]["elements"]
    assert beyond[1]["ended"]


SMALL = Envelope(
    bounded=Ranges(elements=("root_vel_x",), lower=(-1.0,), upper=(1.0,), rate=(2.0,)),
    sums=((1.0,),), spans=(Span(over_s=0.0, lower=(-1.0,), upper=(1.0,)),),
)  # fmt: skip
PLAIN = msgspec.to_builtins(SMALL)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bounded": PLAIN["bounded"] | {"lower": []}}, "lower: 0 numbers, expected 1, one per element"),
        ({"bounded": PLAIN["bounded"] | {"lower": [1.0]}}, "expected less than upper"),
        ({"bounded": PLAIN["bounded"] | {"rate": [0.0]}}, "rate: expected more than 0"),
        ({"bounded": PLAIN["bounded"] | {"upper": [float("inf")]}}, "expected finite numbers"),
        ({"bounded": {"elements": [], "lower": [], "upper": [], "rate": []}}, "bounded: expected elements"),
        ({"reaching": PLAIN["bounded"]}, "root_vel_x is in bounded and in reaching"),
        ({"sums": [[1.0, 2.0]]}, "a row of 2 weights, expected 1"),
        ({"sums": [[1.0], [1.0]]}, "over_s 0: expected 2 ends"),
        ({"spans": [{"over_s": 0, "lower": [0.0], "upper": [1.0]}]}, "standing is inside"),
        ({"spans": [{"over_s": -1, "lower": [-1.0], "upper": [1.0]}]}, "over_s"),
        ({"spans": [{"over_s": 0.01, "lower": [-1.0], "upper": [1.0], "is_change": True}]}, "over 0.05 s or more"),
        ({"sumz": []}, "sumz"),
    ],
)
def test_a_file_that_is_no_envelope_is_refused_in_one_line(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    file = tmp_path / "bad.envelope.yaml"
    text = msgspec.json.encode(PLAIN | change).decode().replace("null", ".inf")
    file.write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        read(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_stated_of_one_is_short_enough_for_every_episode_and_the_same_again(tmp_path: Path) -> None:
    text = stated(ENVELOPE)
    assert from_stated(text) == from_stated(msgspec.to_builtins(ENVELOPE)) == ENVELOPE
    assert len(text) <= MOST_BYTES
    many = ENVELOPE.sums * 8
    spans = tuple(msgspec.structs.replace(each, lower=each.lower * 8, upper=each.upper * 8) for each in ENVELOPE.spans)
    file = tmp_path / "large.envelope.yaml"
    file.write_bytes(msgspec.json.encode(msgspec.structs.replace(ENVELOPE, sums=many, spans=spans)))
    with pytest.raises(ConfigError, match=r"large.envelope.yaml: \d+ characters as JSON, expected at most 100000"):
        read(file)


def test_a_setting_names_the_file_beside_the_checkpoint_another_or_none(tmp_path: Path) -> None:
    own = tmp_path / "mine.envelope.yaml"
    own.write_bytes(msgspec.json.encode(SMALL))
    assert found("auto", CHECKPOINT) == ENVELOPE
    assert found("auto", tmp_path / "mine.onnx") == SMALL
    assert found("auto", tmp_path / "other.onnx") is None
    assert found("none", CHECKPOINT) is None
    assert found(str(own), CHECKPOINT) == SMALL
    with pytest.raises(BadFile, match=r"envelope: of: no such file.*; expected a file, auto or none"):
        found("of", CHECKPOINT)
    with pytest.raises(BadFile, match="no such file"):
        expect(RigConfig(envelope="nowhere.yaml"))


def test_an_envelope_of_another_policy_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"it bounds root_vel_x, which velocity does not have; it is another policy's"
    ):
        of_parts([SMALL], [registry.find("command", "velocity")])
    apart = msgspec.structs.replace(SMALL, bounded=msgspec.structs.replace(SMALL.bounded, lower=(0.5,)))
    with pytest.raises(ConfigError, match="root_vel_x is outside of it when the robot stands"):
        EnvelopeLimit(apart, FORMAT)


def test_the_built_in_tracker_has_one_and_who_wants_none_has_none() -> None:
    assert build(RigConfig()).envelopes == (ENVELOPE,)
    assert build(RigConfig(envelope="none")).envelopes == ()
    path = build(RigConfig(envelope="none")).control().commanded
    low = STANDING.copy()
    low[NAMES.index("root_height")] = FORMAT.lower[NAMES.index("root_height")]
    for tick in range(100):
        made = path.decide(CommandSample(codec.json_vector(low), arrived_s=tick * DT), tick * DT)
    np.testing.assert_array_equal(made.vector, low)
