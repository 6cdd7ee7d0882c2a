"""What was on the bus, or should have been, and is not in the file: that a check tells of it, and of nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from station.bus import keys
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading import steps
from station.episode.reading.reader import open_episode
from tests.episode.synthetic import ROBOT, EpisodeBuilder, walk

BODY = keys.action_body()


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
