"""Commands that end because their server says so, and begin again, are told of with their time and are no fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.cli.quality import print_quality
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from station.protocols import Floats
from tests.episode.synthetic import ROBOT, STANDING, EpisodeBuilder, tick

AWAY = "pico has been away for 5 s"


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path)


def moving(number: int) -> Floats:
    """Joints of a robot that is never idle."""
    return STANDING + 0.2 * np.sin(number / 10)


def drive(builder: EpisodeBuilder, from_s: float, to_s: float, commander: str = "teleop") -> None:
    """Commands that the robot follows, after a blend of a second."""
    for number in range(round(from_s * 50), round(to_s * 50)):
        gate = "entering" if number < round((from_s + 1.0) * 50) and from_s else "tracking"
        tick(builder, number, at_s=number / 50, q=moving(number), commander=commander, gate=gate)


def stand(builder: EpisodeBuilder, from_s: float, to_s: float) -> None:
    """Nobody commands: the gate holds, returns, waits; what it uses grows older and older."""
    for number in range(round(from_s * 50), round(to_s * 50)):
        since_s = number / 50 - from_s
        gate = (
            "tracking" if since_s < 0.1 else "holding" if since_s < 0.3 else "returning" if since_s < 2 else "waiting"
        )
        tick(builder, number, at_s=number / 50, q=moving(number), gate=gate, age_s=since_s, is_commanded=False)


def away(builder: EpisodeBuilder, *, is_told: bool = True, after: str = "teleop") -> Quality:
    """4 s of driving, 8 s of nothing, 4 s of driving."""
    drive(builder, 0.0, 4.0)
    if is_told:
        builder.event("teleop-commands-end", at_s=4.01, source="teleop", severity="warning", reason=AWAY)
    stand(builder, 4.0, 12.0)
    drive(builder, 12.0, 16.0, after)
    return checked(builder)


def checked(builder: EpisodeBuilder) -> Quality:
    return check(open_episode(builder.finish()))


def reasons(quality: Quality) -> dict[str, str]:
    return {reason.rule: reason.text for reason in quality.reasons}


def test_an_operator_whose_device_was_away_is_a_warning_with_its_time(
    builder: EpisodeBuilder, capsys: pytest.CaptureFixture[str]
) -> None:
    quality = away(builder)
    assert quality.verdict == "usable"
    assert reasons(quality) == {"commands-ended": f"commands ended at 4.0 s for 8.0 s: {AWAY}"}
    (pause,) = quality.pauses
    assert (pause.keys, pause.writer) == ([twist_keys.action_body(), keys.command_source(ROBOT)], "teleop")
    print_quality(quality)
    assert f"usable commands-ended: commands ended at 4.0 s for 8.0 s: {AWAY}" in capsys.readouterr().out


def test_a_pause_leaves_no_trace_in_the_numbers_of_the_stream_and_of_the_steps(builder: EpisodeBuilder) -> None:
    quality = away(builder)
    (stream,) = [stream for stream in quality.streams if stream.key == twist_keys.action_body()]
    assert stream.longest_gap_s == pytest.approx(0.02, abs=0.005)
    assert stream.rate_hz == pytest.approx(50.0, rel=0.01)
    assert stream.paused_s == pytest.approx(8.0, abs=0.03)
    (steps,) = quality.steps
    assert steps.interrupted_share == 0.0
    assert steps.command_age.max_s == pytest.approx(0.0041)
    assert steps.gate_shares["waiting"] == pytest.approx(6 / 16, abs=0.01)


def test_the_same_silence_without_a_word_is_rejected(builder: EpisodeBuilder) -> None:
    quality = away(builder, is_told=False)
    assert quality.verdict == "reject"
    assert {"gap", "interrupted", "old-command"} <= set(reasons(quality))
    assert quality.pauses == []


def test_what_another_server_said_excuses_nobody(builder: EpisodeBuilder) -> None:
    drive(builder, 0.0, 4.0)
    builder.event("teleop-commands-end", at_s=4.01, source="other", reason=AWAY)
    stand(builder, 4.0, 12.0)
    drive(builder, 12.0, 16.0)
    assert "gap" in reasons(checked(builder))


def test_a_silence_long_after_an_end_that_was_told_is_rejected(builder: EpisodeBuilder) -> None:
    drive(builder, 0.0, 4.0)
    builder.event("teleop-commands-end", at_s=4.01, source="teleop", reason=AWAY)
    stand(builder, 4.0, 12.0)
    drive(builder, 12.0, 16.0)
    stand(builder, 16.0, 18.0)  # this time nobody said a word
    drive(builder, 18.0, 20.0)
    found = reasons(checked(builder))
    assert "silent for 2.02" in found["gap"]
    assert found["commands-ended"].startswith("commands ended at 4.0 s for 8.0 s")


def test_two_motions_one_after_the_other_are_told_of_in_the_same_way(builder: EpisodeBuilder) -> None:
    drive(builder, 0.0, 4.0, "motion")
    builder.event("motion-end", at_s=3.0, source="motion", is_complete=True)  # and a blend to standing follows
    stand(builder, 4.0, 9.0)
    drive(builder, 9.0, 12.0, "second")
    quality = checked(builder)
    assert reasons(quality) == {"commands-ended": "commands ended at 4.0 s for 5.0 s: the motion was over"}


def test_an_operator_who_takes_over_from_a_motion_and_back_is_no_rival_of_it(builder: EpisodeBuilder) -> None:
    drive(builder, 0.0, 3.0, "teleop")
    builder.event("teleop-commands-end", at_s=3.01, source="teleop", reason=AWAY)
    stand(builder, 3.0, 5.0)
    drive(builder, 5.0, 8.0, "motion")
    builder.event("motion-end", at_s=7.0, source="motion")
    stand(builder, 8.0, 10.0)
    drive(builder, 10.0, 13.0, "teleop")
    quality = checked(builder)
    assert quality.rivals == []
    text = f"commands ended at 3.0 s for 2.0 s: {AWAY}; 1 more time(s), 4.0 s in all"
    assert reasons(quality) == {"commands-ended": text}


def test_commands_that_ended_for_good_are_no_pause(builder: EpisodeBuilder) -> None:
    drive(builder, 0.0, 4.0)
    builder.event("operator-exit", at_s=3.0, source="teleop")
    stand(builder, 4.0, 6.0)
    quality = checked(builder)
    assert (quality.verdict, quality.pauses) == ("good", [])
