"""What was on the bus, or should have been, and is not in the file: that a check tells of it, and of nothing else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading import steps
from station.episode.reading.reader import open_episode
from tests.episode.filming import cloud
from tests.episode.synthetic import ROBOT, WALL_START_NS, EpisodeBuilder, tick, walk
from tests.export import pictured

BODY = twist_keys.action_body()


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path)


def said(quality: Quality) -> list[tuple[str, str]]:
    return [(reason.rule, reason.verdict) for reason in quality.reasons]


def not_mirrored(builder: EpisodeBuilder, command: str, key: str, *, at_s: float) -> None:
    builder.foreign(keys.NOT_MIRRORED, json.dumps({"command": command, "key": key}).encode(), at_s=at_s)


def test_a_command_that_the_tap_could_not_know_rejects_with_key_command_count_and_time(builder: EpisodeBuilder) -> None:
    walk(builder)
    for at_s in (0.5, 0.6):
        not_mirrored(builder, "BITFIELD", BODY, at_s=at_s)
    quality = check(open_episode(builder.finish()))
    assert said(quality) == [("not-mirrored", "reject")]
    assert f"2 write(s) on the bus are not in the file, the first at 0.50 s: {BODY} by BITFIELD 2" in (
        quality.reasons[0].text
    )


def test_the_same_of_a_key_that_no_robot_knows_leaves_the_episode_usable(builder: EpisodeBuilder) -> None:
    walk(builder)
    not_mirrored(builder, "HSET", "own", at_s=0.5)
    assert said(check(open_episode(builder.finish()))) == [("not-mirrored", "usable")]


def test_a_strangers_value_under_the_name_of_such_a_word_is_no_error(builder: EpisodeBuilder) -> None:
    walk(builder)
    for value in (b"\xff", b"[1]", b'{"command": 5}', b'{"command": "X", "key": "", "count": -1}'):
        builder.foreign(keys.NOT_MIRRORED, value, at_s=0.5)
    assert check(open_episode(builder.finish())).not_mirrored == []


def test_deleted_keys_of_a_robot_are_told_and_those_of_others_are_not(builder: EpisodeBuilder) -> None:
    walk(builder)
    for key in (BODY, keys.robot_state(ROBOT), "own", keys.RECORDER):  # as FLUSHALL does
        builder.delete(key, at_s=1.0)
    quality = check(open_episode(builder.finish()))
    assert said(quality) == [("deleted", "usable")]
    assert quality.reasons[0].text == f"2 deletion(s) of keys, the first at 1.00 s: {BODY}, {keys.robot_state(ROBOT)}"


@pytest.mark.parametrize("family", [keys.policy_timing, keys.policy_obs, keys.command_gate])
def test_a_deleted_stamp_makes_no_robot_and_a_deleted_key_no_step(
    builder: EpisodeBuilder, family: steps.Family
) -> None:
    walk(builder)
    builder.delete(keys.stamp(family(ROBOT)), at_s=1.0)
    builder.delete(family(ROBOT), at_s=1.1)
    quality = check(open_episode(builder.finish()))
    assert [(one.robot, one.steps) for one in quality.steps] == [(ROBOT, 100)]
    assert said(quality) == [("deleted", "usable")]


SERVERS = {"g1": {"role": "low-level"}, "motion": {"role": "command"}}
LENGTH_S = 6.0


def run(
    builder: EpisodeBuilder,
    *,
    robot: tuple[float, float] = (0.0, LENGTH_S),
    commander: tuple[float, float] | None = None,
) -> None:
    """Ticks of a robot from one instant to another [s], commanded all the time unless told otherwise."""
    first_s, last_s = commander or robot
    for number in range(round(robot[0] * 50), round(robot[1] * 50)):
        at_s = number / 50
        is_commanded = first_s <= at_s < last_s
        gate = "tracking" if is_commanded else "waiting"
        tick(builder, number, at_s=at_s, is_commanded=is_commanded, gate=gate)


def finished(builder: EpisodeBuilder, **manifest: Any) -> Quality:
    """The quality of an episode that was recorded from 0 to `LENGTH_S`."""
    timing = {"duration_s": LENGTH_S}
    return check(open_episode(builder.finish({"timing": timing, "servers": SERVERS, **manifest})))


def test_a_robot_that_was_killed_at_half_rejects_with_its_share_and_seconds(builder: EpisodeBuilder) -> None:
    run(builder, robot=(0.0, 3.0), commander=(0.0, 3.0))
    quality = finished(builder)
    assert set(said(quality)) == {("ended-early", "reject")} | {("ended-early", "usable")}  # robot, and its commander
    text = next(reason.text for reason in quality.reasons if reason.verdict == "reject")
    assert "by g1: nothing in the last 3.0 s (50% of the episode); at most that long: 8 more of its keys" in text


def test_a_robot_that_was_frozen_at_first_rejects(builder: EpisodeBuilder) -> None:
    run(builder, robot=(2.5, LENGTH_S))
    quality = finished(builder)
    assert said(quality) == [("began-late", "reject")]
    assert "nothing in the first 2.5 s (42% of the episode)" in quality.reasons[0].text


@pytest.mark.parametrize("family", [keys.target, keys.robot_state, keys.policy_obs])
def test_one_key_of_a_robot_that_ends_at_half_rejects(builder: EpisodeBuilder, family: steps.Family) -> None:
    run(builder, robot=(0.0, LENGTH_S))
    whole, half = open_episode(builder.finish({"timing": {"duration_s": LENGTH_S}})), EpisodeBuilder(builder.folder)
    for message in whole.messages():
        at_s = (message.publish_ns - WALL_START_NS) * 1e-9
        if message.topic != family(ROBOT) or at_s < 3.0:
            half.write({message.topic: message.data}, at_s=at_s, writer=message.channel.writer)
    assert said(finished(half)) == [("ended-early", "reject")]


@pytest.mark.parametrize("family", [keys.robot_state, keys.command_used])
def test_policy_steps_without_their_states_or_commands_reject(builder: EpisodeBuilder, family: steps.Family) -> None:
    run(builder, robot=(0.0, LENGTH_S))
    whole, spoiled = open_episode(builder.finish({"timing": {"duration_s": LENGTH_S}})), EpisodeBuilder(builder.folder)
    for message in whole.messages():
        if message.topic != family(ROBOT):
            at_s = (message.publish_ns - WALL_START_NS) * 1e-9
            spoiled.write({message.topic: message.data}, at_s=at_s, writer=message.channel.writer)
    (reason,) = [reason for reason in finished(spoiled).reasons if reason.rule == "missing-keys"]
    assert reason.verdict == "reject"
    assert family(ROBOT) in reason.text


def test_commands_that_fall_silent_long_before_their_servers_farewell_leave_the_episode_usable(
    builder: EpisodeBuilder,
) -> None:
    run(builder, commander=(0.0, 2.0))
    builder.event("motion-end", at_s=4.5, source="motion")
    builder.write({keys.server("motion"): b'{"state": "finalized"}'}, at_s=5.0, writer="motion")
    assert said(finished(builder)) == [("ended-early", "usable")]


def test_an_end_that_lacks_a_little_leaves_the_episode_usable(builder: EpisodeBuilder) -> None:
    run(builder, robot=(0.0, LENGTH_S - 0.55), commander=(0.0, LENGTH_S - 0.55))
    assert set(said(finished(builder))) == {("ended-early", "usable")}


@pytest.mark.parametrize("name", ["motion-end", "operator-exit", "teleop-commands-end"])
def test_commands_that_end_because_their_server_says_so_are_no_fault(builder: EpisodeBuilder, name: str) -> None:
    run(builder, commander=(1.0, 5.0))
    builder.event(name, at_s=3.0, source="motion")  # and then a blend to standing
    assert said(finished(builder)) == []


def test_commands_that_end_because_their_server_was_asked_to_are_no_fault(builder: EpisodeBuilder) -> None:
    run(builder, commander=(0.0, 5.0))
    builder.write({keys.server("motion"): b'{"state": "finalized"}'}, at_s=5.1, writer="motion")
    assert said(finished(builder)) == []


@pytest.mark.parametrize("ends_at_s", [None, -2.0])
def test_commands_that_end_without_a_word_leave_the_episode_usable(
    builder: EpisodeBuilder, ends_at_s: float | None
) -> None:
    run(builder, commander=(0.0, 4.0))
    if ends_at_s is not None:  # of a motion before this one
        builder.event("motion-end", at_s=ends_at_s, source="motion")
    quality = finished(builder)
    assert said(quality) == [("ended-early", "usable")]
    assert "by motion: nothing in the last 2.0 s (34% of the episode)" in quality.reasons[0].text


def test_commands_of_the_preroll_alone_are_no_fault_and_a_robot_of_the_preroll_alone_is(
    builder: EpisodeBuilder,
) -> None:
    run(builder)
    builder.write({twist_keys.action_neck(): b"[0, 0]"}, at_s=-1.0, writer="pico")
    builder.write({twist_keys.state_neck(): b"[0, 0]"}, at_s=-1.0)
    quality = finished(builder)
    assert said(quality) == [("ended-early", "reject")]
    assert "state_neck" in quality.reasons[0].text


def test_a_robot_whose_server_was_started_again_is_told_of_by_the_silence_between(builder: EpisodeBuilder) -> None:
    for number in range(300):
        if not 100 <= number < 150:
            builder.write({twist_keys.T_STATE: b"1"}, at_s=number / 50, writer="g1" if number < 100 else "g1again")
    quality = finished(builder)
    assert said(quality) == [("writer-gap", "reject"), ("no-steps", "usable")]
    assert any("t_state: silent for 1.02 s until another process wrote it" in one.text for one in quality.reasons)


def test_a_robot_that_writes_rarely_by_its_contract_is_not_asked_for_its_ends(builder: EpisodeBuilder) -> None:
    run(builder)
    builder.write({keys.MOTION_CONTROL: b"{}", keys.ESTOP: b"0"}, at_s=5.0)
    assert said(finished(builder)) == []


def test_ends_are_not_asked_of_lock_step(builder: EpisodeBuilder) -> None:
    run(builder, robot=(1.0, 4.0))
    quality = finished(builder, servers={"g1": {"role": "low-level", "pace": "command"}})
    assert "ended-early" in quality.not_judged
    assert said(quality) == []


def test_a_bus_that_did_not_come_back_ended_the_episode_not_the_robot(builder: EpisodeBuilder) -> None:
    run(builder, robot=(0.0, 3.0))
    recorder = {"backend": "replication", "is_lossless": True, "ended_by": "bus-lost"}
    assert said(finished(builder, recorder=recorder)) == [("bus-lost", "usable")]


@pytest.mark.parametrize(
    ("name", "server", "verdict"),
    [
        ("server-died", "g1", "reject"),
        ("server-silent", "g1", "reject"),
        ("server-restarted", "gamepad", "usable"),
        ("server-given-up", "gamepad", "usable"),
        ("server-died", "motion", "usable"),
    ],
)
def test_a_death_that_the_supervisor_tells_of_is_a_finding(
    builder: EpisodeBuilder, name: str, server: str, verdict: str
) -> None:
    run(builder)
    reason = "was killed by SIGKILL; its last words: ready"
    builder.event(name, at_s=5.9, source="supervisor", severity="error", server=server, reason=reason)
    quality = finished(builder)
    assert said(quality) == [("server-died", verdict)]
    assert quality.reasons[0].text == f"server {server} at 5.90 s: {name}, {reason}"


def test_a_recorder_that_was_started_again_and_what_died_before_the_start_are_no_findings(
    builder: EpisodeBuilder,
) -> None:
    run(builder)
    servers = {**SERVERS, "mirror": {"role": "recorder"}}
    builder.event("server-died", at_s=-0.5, source="supervisor", server="g1", reason="was killed")
    for server in ("recorder", "mirror"):
        builder.event("server-restarted", at_s=5.0, source="supervisor", server=server, reason="was killed")
    assert said(finished(builder, servers=servers)) == []


HEAD = keys.camera_image("head")
CAMERA = {"head": {"role": "sensor", "key": HEAD, "camera": "head", "fps": 30}}


def film(builder: EpisodeBuilder, from_s: float, to_s: float) -> None:
    for number in range(round(from_s * 30), round(to_s * 30)):
        builder.write({HEAD: pictured.jpeg(number)}, at_s=number / 30, writer="head")


@pytest.mark.parametrize(
    ("from_s", "to_s", "expected"),
    [
        (0.0, LENGTH_S, []),
        (0.3, LENGTH_S - 0.3, []),
        (0.0, 3.0, [("camera-ended-early", "reject")]),
        (1.5, LENGTH_S, [("camera-began-late", "reject")]),
        (0.0, LENGTH_S - 0.7, [("camera-ended-early", "usable")]),
    ],
)
def test_a_camera_is_asked_for_both_ends(
    builder: EpisodeBuilder, from_s: float, to_s: float, expected: list[tuple[str, str]]
) -> None:
    run(builder)
    film(builder, from_s, to_s)
    quality = finished(builder, servers=SERVERS | CAMERA)
    assert said(quality) == expected
    assert all("camera head: no picture in the" in reason.text for reason in quality.reasons)


def test_a_camera_of_few_pictures_a_second_may_be_three_periods_away(builder: EpisodeBuilder) -> None:
    run(builder)
    for at_s in (1.0, 3.0, 5.0):
        builder.write({HEAD: pictured.jpeg(round(at_s))}, at_s=at_s, writer="head")
    assert said(finished(builder, servers=SERVERS | {"head": CAMERA["head"] | {"fps": 0.5}})) == []


@pytest.mark.parametrize(
    ("beats", "expected"),
    [
        ({"g1": "active", "head": "active"}, [("no-pictures", "reject")]),
        ({}, [("no-pictures", "reject")]),  # nothing says who lived
        ({"g1": "active", "head": "finalized"}, []),
        ({"g1": "active"}, []),  # the configuration of an earlier session
    ],
)
def test_a_camera_whose_server_lived_and_that_gave_no_picture_rejects(
    builder: EpisodeBuilder, beats: dict[str, str], expected: list[tuple[str, str]]
) -> None:
    run(builder)
    for name, state in beats.items():
        builder.write({keys.server(name): json.dumps({"state": state}).encode()}, at_s=5.0, writer=name)
    assert said(finished(builder, servers=SERVERS | CAMERA)) == expected


LIDAR = {"top": {"role": "sensor", "key": keys.lidar_cloud("top"), "lidar": "top"}}


def scan(builder: EpisodeBuilder, *, gap_s: tuple[float, float] = (0.0, 0.0)) -> None:
    for number in range(round(10 * LENGTH_S)):
        if not gap_s[0] < number / 10 < gap_s[1]:
            builder.write({keys.lidar_cloud("top"): cloud(number)}, at_s=number / 10, writer="top")


def test_clouds_are_counted_and_a_gap_in_them_is_told(builder: EpisodeBuilder) -> None:
    run(builder)
    scan(builder, gap_s=(2.0, 4.0))
    quality = finished(builder, servers=SERVERS | LIDAR)
    (stream,) = [one for one in quality.streams if one.key == keys.lidar_cloud("top")]
    assert stream.count == round(10 * LENGTH_S) - 19
    assert any(rule == "device-gap" for rule, _ in said(quality))


def test_a_lidar_that_gave_nothing_rejects_and_one_that_was_lost_is_told(builder: EpisodeBuilder) -> None:
    run(builder)
    builder.write({keys.server("top"): b'{"state": "active"}'}, at_s=5.0, writer="top")
    builder.event("lidar-lost", at_s=5.0, source="top", severity="warning", key=keys.lidar_cloud("top"), reason="off")
    quality = finished(builder, servers=SERVERS | LIDAR)
    assert [(r.rule, r.verdict, r.text) for r in quality.reasons] == [
        ("no-pictures", "reject", "lidar top: its server lived, and there is no cloud of it"),
        ("camera-lost", "usable", "lidar top lost at 5.00 s: off"),
    ]


def test_a_camera_that_was_lost_is_told_with_its_time_and_reason(builder: EpisodeBuilder) -> None:
    run(builder)
    film(builder, 0.0, LENGTH_S)
    builder.event("camera-lost", at_s=5.0, source="head", severity="warning", key=HEAD, reason="unplugged")
    quality = finished(builder, servers=SERVERS | CAMERA)
    assert [(r.rule, r.verdict, r.text) for r in quality.reasons] == [
        ("camera-lost", "usable", "camera head lost at 5.00 s: unplugged")
    ]
