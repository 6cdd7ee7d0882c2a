"""Checking: what is measured, what is made of it, and that every rule can speak."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station.bus import codec, keys
from station.episode.quality import rule_file
from station.episode.quality.check import check, write_measured
from station.episode.quality.findings import Quality
from station.episode.quality.rule_file import LeastShare
from station.episode.quality.rules import RULES
from station.episode.quality.sensed_rules import SENSED
from station.episode.quality.state_rules import PLAUSIBLE
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from station.errors import EpisodeError
from tests.episode.synthetic import ROBOT, STANDING, EpisodeBuilder, command, tick, walk

FAST = {"seconds": 1.0}
FALLEN = (0.5, 0.0, 0.866, 0.0)
"""Pitched forward by 120°."""


def checked(builder: EpisodeBuilder, manifest: dict[str, Any] | None = None, *, torn: bool = False) -> Quality:
    return check(open_episode(builder.finish(manifest, torn=torn)))


def reasons(quality: Quality) -> set[str]:
    return {reason.rule for reason in quality.reasons}


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path)


def test_a_run_without_a_fault_is_good(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=2.0)
    quality = checked(builder)
    assert (quality.verdict, quality.reasons) == ("good", [])
    assert quality.falls == quality.recorder_restarts == quality.dropped == 0


def test_streams_are_counted_and_timed(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=2.0)
    streams = {stream.key: stream for stream in checked(builder).streams}
    stream = streams[twist_keys.action_body()]
    assert (stream.count, stream.lost, stream.writer, stream.role, stream.nominal_hz) == (
        100, 0, "motion", "command", 50.0,
    )  # fmt: skip
    assert stream.rate_hz == pytest.approx(50.0)
    assert stream.longest_gap_s == pytest.approx(0.02)
    assert stream.jitter_p99_s == pytest.approx(0.0, abs=1e-9)
    assert stream.first_s == pytest.approx(0.096)


def test_report_has_the_names_that_scripts_rely_on(builder: EpisodeBuilder) -> None:
    walk(builder, **FAST)
    found = json.loads(msgspec.json.encode(checked(builder)))
    assert {"verdict", "streams", "recorder_restarts", "falls"} <= set(found)
    assert {"key", "count", "lost", "rate_hz", "longest_gap_s"} <= set(found["streams"][0])


def test_numbers_that_wrap_around_are_no_loss(builder: EpisodeBuilder) -> None:
    top = (1 << 32) - 3
    for count in range(6):
        builder.repeat(twist_keys.T_STATE, b"1", at_s=0.02 * count, seq=(top + count) % (1 << 32))
    (stream,) = checked(builder).streams
    assert (stream.lost, stream.repeated, stream.out_of_order) == (0, 0, 0)


def test_lost_repeated_and_disordered_writes_are_told_apart(builder: EpisodeBuilder) -> None:
    for count, seq in enumerate((1, 2, 2, 5, 4, 8)):  # 3, 6 and 7 are missing
        builder.repeat(twist_keys.T_STATE, b"1", at_s=0.02 * count, seq=seq)
    (stream,) = checked(builder).streams
    assert (stream.lost, stream.repeated, stream.out_of_order) == (3, 1, 1)


def test_foreign_writers_are_named_and_not_counted_as_lossy(builder: EpisodeBuilder) -> None:
    for count in range(5):
        builder.foreign(twist_keys.action_body(), codec.json_vector(command()), at_s=0.02 * count)
    (stream,) = checked(builder).streams
    assert (stream.writer, stream.is_native, stream.lost, stream.count) == ("foreign", False, 0, 5)


def test_latency_of_each_stage_comes_from_the_recorded_instants(builder: EpisodeBuilder) -> None:
    for number in range(100):
        tick(builder, number, at_s=0.02 * number, slow_s=0.010 if number == 50 else 0.0)
    (steps,) = checked(builder).steps
    assert list(steps.stages) == [
        "command_written_to_command_arrived",
        "command_arrived_to_state_read",
        "state_read_to_observed",
        "observed_to_inferred",
        "inferred_to_sent",
        "command_written_to_sent",
    ]
    inferred = steps.stages["observed_to_inferred"]
    assert (inferred.count, inferred.p50_s, inferred.max_s) == (100, pytest.approx(0.0029), pytest.approx(0.0129))
    assert steps.command_age.p50_s == pytest.approx(0.0041)


def test_shares_of_the_gate_are_shares_of_time(builder: EpisodeBuilder) -> None:
    for number in range(100):
        gate = "entering" if number < 50 else "tracking"
        tick(builder, number, at_s=0.02 * number, gate=gate)
    (steps,) = checked(builder).steps
    assert steps.gate_shares == pytest.approx({"entering": 0.5, "tracking": 0.5})
    assert steps.interrupted_share == 0.0


def test_tracking_error_counts_only_while_the_motion_plays_and_the_gate_tracks(builder: EpisodeBuilder) -> None:
    off = command(STANDING + 0.1, height=0.74)
    for number in range(40):
        gate = "tracking" if number >= 10 else "entering"
        phase = "playing" if number < 30 else "leaving"
        far = command(STANDING + 0.5)
        tick(builder, number, at_s=0.02 * number, gate=gate, phase=phase, asked=off if 10 <= number < 30 else far)
    (steps,) = checked(builder).steps
    assert steps.compared_steps == 20
    assert steps.mean_joint_error_rad == pytest.approx(0.1)
    assert steps.mean_root_height_error_m == pytest.approx(0.05)


def test_the_worst_joint_is_named(builder: EpisodeBuilder) -> None:
    q = STANDING.copy()
    q[3] += 0.2
    walk(builder, asked=command(q), **FAST)
    (steps,) = checked(builder).steps
    assert (steps.worst_joint, steps.worst_joint_error_rad) == ("left_knee", pytest.approx(0.2))


def test_joints_that_are_no_numbers_take_no_part_in_errors(builder: EpisodeBuilder) -> None:
    for number in range(20):
        q = STANDING.copy()
        q[0] = np.nan
        q[1] = np.nan if number % 2 else q[1]
        tick(builder, number, at_s=0.02 * number, q=q, asked=command(STANDING + 0.1))
    quality = checked(builder)
    errors = quality.joint_errors_rad(ROBOT)
    assert list(errors) == list(G1_29[1:])
    assert list(errors.values()) == pytest.approx([0.1] * 28)
    assert quality.steps[0].mean_joint_error_rad == pytest.approx(0.1)
    assert quality.joint_errors_rad("another") == {}


def test_a_fall_is_seen_in_the_pose_alone(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=1.0)
    for number in range(50, 70):
        tick(builder, number, at_s=0.1 + number / 50, quat=FALLEN, height=0.2)
    quality = checked(builder)
    (fall,) = quality.falls_seen
    assert (quality.falls, fall.seen_by, fall.robot) == (1, "pose", ROBOT)
    assert fall.at_s == pytest.approx(1.1, abs=0.02)
    assert fall.tilt_rad == pytest.approx(np.radians(120), abs=0.01)


def test_a_robot_that_outlives_its_commander_is_not_blamed_for_an_old_command(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=1.0)
    for number in range(50, 100):
        tick(builder, number, at_s=0.1 + number / 50, gate="waiting", age_s=(number - 49) / 50)
    quality = checked(builder)
    assert quality.steps[0].command_age.count == 50
    assert "old-command" not in {reason.rule for reason in quality.reasons}


def test_a_bow_from_the_waist_is_no_fall(builder: EpisodeBuilder) -> None:
    bowed = STANDING.copy()
    bowed[14] = 1.2  # waist pitch; the pelvis itself stays level
    walk(builder, q=bowed, **FAST)
    assert checked(builder).falls == 0


def test_a_fall_that_was_reported_is_counted_once(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=1.0)
    builder.event("fall", at_s=1.0, severity="error", tilt_rad=0.4, contacts=["left_rubber_hand"])
    for number in range(50, 70):
        tick(builder, number, at_s=0.1 + number / 50, quat=FALLEN, height=0.2)
    (fall,) = checked(builder).falls_seen
    assert (fall.seen_by, fall.contacts) == ("event", ["left_rubber_hand"])


def test_two_writers_one_after_the_other_are_no_rivals(builder: EpisodeBuilder) -> None:
    for count in range(10):
        value = {twist_keys.action_body(): codec.json_vector(command())}
        builder.write(value, at_s=0.02 * count, writer="motion" if count < 5 else "pico")
    assert checked(builder).rivals == []


def test_times_are_not_judged_in_lock_step(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=2.0, rate_hz=5.0)
    servers = {"g1": {"config": {"pace": "command"}}}
    quality = checked(builder, {"servers": servers})
    assert quality.lock_step
    assert not {"slow", "gap"} & reasons(quality)
    assert {"slow", "gap", "idle-ends"} <= set(quality.not_judged)


def test_what_was_measured_stands_in_the_manifest(builder: EpisodeBuilder) -> None:
    walk(builder, **FAST)
    folder = builder.finish()
    quality = check(open_episode(folder))
    write_measured(folder, quality)
    manifest = load_manifest(folder)
    assert manifest.quality["verdict"] == "good"
    assert len(manifest.quality["streams"]) == len(quality.streams)
    assert manifest.episode_id == quality.episode_id
    assert [path.name for path in folder.iterdir() if path.name.startswith(".")] == []


def test_a_manifest_that_its_recorder_still_owns_is_left_alone(builder: EpisodeBuilder) -> None:
    walk(builder, **FAST)
    folder = builder.finish(torn=True)
    with pytest.raises(EpisodeError, match="not finished"):
        write_measured(folder, check(open_episode(folder)))


def _silence(builder: EpisodeBuilder, seconds: float) -> None:
    walk(builder, seconds=1.0)
    for number in range(50, 100):
        tick(builder, number, at_s=0.1 + seconds + number / 50)


def _lose(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=4.0)
    builder.skip(twist_keys.T_STATE)
    for count in range(200):
        builder.write({twist_keys.T_STATE: b"1"}, at_s=0.1 + count / 50)
    builder.skip(twist_keys.T_STATE)
    builder.write({twist_keys.T_STATE: b"1"}, at_s=4.1)


def _lose_many(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=1.0)
    for _ in range(5):
        builder.skip(keys.policy_obs(ROBOT))
    tick(builder, 51, at_s=1.12)


def _interrupt(builder: EpisodeBuilder, steps: int) -> None:
    for number in range(100):
        tick(builder, number, at_s=0.1 + number / 50, gate="holding" if 40 <= number < 40 + steps else "tracking")


def _rival(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=1.0)
    builder.foreign(twist_keys.action_body(), codec.json_vector(command()), at_s=0.5)
    builder.foreign(twist_keys.action_body(), codec.json_vector(command()), at_s=0.6)


def _fell(builder: EpisodeBuilder) -> None:
    walk(builder, **FAST)
    builder.event("fall", at_s=1.0, tilt_rad=1.2, contacts=[])


def _event(name: str) -> Callable[[EpisodeBuilder], None]:
    def fill(builder: EpisodeBuilder) -> None:
        walk(builder, **FAST)
        builder.event(name, at_s=0.5)

    return fill


def _end_commands(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=1.0)
    builder.event("teleop-commands-end", at_s=1.09, source="motion", reason="away")
    for number in range(50, 100):
        tick(builder, number, at_s=0.1 + number / 50, gate="waiting", is_commanded=False)
    for number in range(100, 150):
        tick(builder, number, at_s=0.1 + number / 50)


def _plain(**options: Any) -> Callable[[EpisodeBuilder], None]:
    return lambda builder: walk(builder, **{**FAST, **options})


def _disorder(builder: EpisodeBuilder) -> None:
    walk(builder, **FAST)
    builder.repeat(keys.MOTION_CONTROL, b"1", at_s=0.1, seq=1)
    builder.repeat(keys.MOTION_CONTROL, b"1", at_s=0.12, seq=1)


def _only_events(builder: EpisodeBuilder) -> None:
    builder.event("mark", at_s=0.1)


def _nothing(_: EpisodeBuilder) -> None:
    pass


def _device(builder: EpisodeBuilder, gap_s: float, *, slow_s: float = 0.0) -> None:
    """A device that pauses after a second, and one that is starved for two."""
    walk(builder, seconds=8.0)
    at_s, number = 0.1, 0
    while at_s < 8.0:
        builder.write({keys.operator_status("pico"): b"{}"}, at_s=at_s, writer="pico")
        at_s += 0.01 + slow_s * (150 <= number < 300) + gap_s * (number == 100)
        number += 1


def _heartbeats(builder: EpisodeBuilder, *, gap_s: float) -> None:
    walk(builder, seconds=6.0)
    for number in range(8):
        health = {keys.server("pico"): codec.json_object({"state": "active"})}
        builder.write(health, at_s=0.2 + 0.5 * number + gap_s * (number > 3), writer="pico")


def _incomplete(builder: EpisodeBuilder) -> None:
    write, lost = builder.write, keys.command_used(ROBOT)
    for number in range(100):
        if 50 <= number < 55:
            builder.write = lambda values, **when: write(  # type: ignore[method-assign]
                {key: value for key, value in values.items() if key != lost}, **when
            )
        tick(builder, number, at_s=0.1 + number / 50)
        builder.write = write  # type: ignore[method-assign]


LOSSLESS = {"backend": "replication", "is_lossless": True}
CASES: dict[str, tuple[Callable[[EpisodeBuilder], None], dict[str, Any], str]] = {
    "empty": (_nothing, {}, "reject"),
    "discarded": (_plain(), {"quality_flags": {"discarded": True}}, "reject"),
    "failed-task": (_plain(), {"quality_flags": {"success": False}}, "reject"),
    "fell": (_fell, {}, "reject"),
    "lost": (_lose_many, {}, "reject"),
    "dropped": (_plain(), {"recorder": {**LOSSLESS, "dropped": 1}}, "reject"),
    "disordered": (_disorder, {}, "usable"),
    "lossy-tap": (_plain(), {"recorder": {"backend": "poll"}}, "usable"),
    "holes": (_plain(), {"recorder": {**LOSSLESS, "restarts": 1}, "holes": [{"from_s": 0.5}]}, "reject"),
    "gap": (lambda builder: _silence(builder, 2.0), {}, "reject"),
    "device-gap": (lambda builder: _device(builder, 0.3), {}, "usable"),
    "device-slow": (lambda builder: _device(builder, 0.0, slow_s=0.01), {}, "usable"),
    "server-paused": (lambda builder: _heartbeats(builder, gap_s=1.5), {}, "usable"),
    "slow": (_plain(rate_hz=30.0), {}, "usable"),
    "rival-writers": (_rival, {}, "reject"),
    "bus-silent": (_event("bus-silent"), {}, "usable"),
    "bus-lost": (_event("bus-back"), {}, "usable"),
    "bus-refused": (_event("bus-refused"), {}, "usable"),
    "operator-reset": (_event("operator-reset"), {}, "usable"),
    "estop": (_event("estop"), {}, "reject"),
    "no-steps": (_only_events, {}, "usable"),
    "incomplete-steps": (_incomplete, {}, "usable"),
    "never-tracked": (_plain(gate="waiting"), {}, "reject"),
    "commands-ended": (_end_commands, {}, "usable"),
    "interrupted": (lambda builder: _interrupt(builder, 10), {}, "usable"),
    "old-command": (_plain(age_s=0.15), {}, "usable"),
    "poor-tracking": (_plain(asked=command(STANDING + 0.2)), {}, "usable"),
    "wrong-height": (_plain(asked=command(height=0.6)), {}, "usable"),
}


@pytest.mark.parametrize("rule", CASES)
def test_each_rule_speaks_for_its_own_fault_alone(builder: EpisodeBuilder, rule: str) -> None:
    fill, manifest, verdict = CASES[rule]
    fill(builder)
    quality = checked(builder, manifest)
    expected = {"empty": {"empty", "no-steps"}}.get(rule, {rule})
    assert reasons(quality) == expected, quality.reasons
    assert quality.verdict == verdict


@pytest.mark.parametrize(
    ("fill", "verdict"),
    [
        (_lose, "usable"),
        (lambda builder: _silence(builder, 0.4), "usable"),
        (lambda builder: _interrupt(builder, 40), "reject"),
        (_plain(asked=command(STANDING + 0.4)), "reject"),
    ],
    ids=["one lost", "short gap", "long interruption", "no tracking to speak of"],
)
def test_size_of_a_fault_decides_between_usable_and_reject(
    builder: EpisodeBuilder, fill: Callable[[EpisodeBuilder], None], verdict: str
) -> None:
    fill(builder)
    assert checked(builder).verdict == verdict


def test_torn_file_is_rejected_with_what_was_cut(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=2.0)
    folder = builder.finish()
    signals = folder / "signals.mcap"
    signals.write_bytes(signals.read_bytes()[:-5000])
    quality = check(open_episode(folder))
    assert quality.verdict == "reject"
    assert "torn" in reasons(quality)


def test_unfinished_file_is_rejected(builder: EpisodeBuilder) -> None:
    walk(builder, **FAST)
    quality = checked(builder, torn=True)
    assert quality.verdict == "reject"
    assert reasons(quality) & {"torn", "unfinished"}


def test_every_rule_has_a_case() -> None:
    in_test_missing = {
        "began-late", "ended-early", "writer-gap", "server-died", "no-pictures", "camera-began-late",
        "camera-ended-early", "camera-lost", "not-mirrored", "deleted", "missing-keys",
    }  # fmt: skip
    in_test_changed_files = {"changed", "manifest-changed", "audit-differs"}
    others = {"torn", "unfinished", "dropped-images"} | in_test_missing | in_test_changed_files
    assert set(RULES) == set(CASES) | others | set(SENSED) | set(PLAUSIBLE)  # the last two: tests of their own


def test_a_device_of_a_rate_of_its_own_is_not_starved(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=6.0)
    for number in range(300):
        builder.write({keys.operator_status("keyboard"): b"{}"}, at_s=0.1 + 0.02 * number, writer="keyboard")
    assert reasons(checked(builder)) == set()


def test_a_device_that_says_its_last_word_late_was_not_silent(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=6.0)
    for number in range(550):
        builder.write({keys.operator_status("pico"): b"{}"}, at_s=0.1 + 0.01 * number, writer="pico")
    builder.write({keys.operator_status("pico"): b"{}"}, at_s=6.05, writer="pico")
    assert reasons(checked(builder)) == set()


def test_a_server_that_waits_for_its_turn_and_is_paused_is_told(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=6.0)
    for at_s in (0.2, 0.7, 2.5, 3.0):
        builder.write({keys.server("head"): codec.json_object({"state": "inactive"})}, at_s=at_s, writer="head")
    (reason,) = checked(builder).reasons
    assert reason.text.startswith(
        "server head (station:server:head): did not say that it works for 1.80 s from 0.70 s on"
    )


def test_a_server_that_starts_slowly_was_not_paused(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=6.0)
    for at_s, state in ((0.2, "unconfigured"), (2.2, "inactive"), (4.0, "active"), (4.5, "active")):
        builder.write({keys.server("head"): codec.json_object({"state": state})}, at_s=at_s, writer="head")
    assert reasons(checked(builder)) == set()


def test_limits_can_be_changed(builder: EpisodeBuilder) -> None:
    walk(builder, rate_hz=30.0, **FAST)
    reader = open_episode(builder.finish())
    limits = replace(rule_file.shipped().limits, slow=LeastShare(verdict="usable", below_share=0.5))
    assert check(reader, rule_file.RuleBook(limits, ())).verdict == "good"
