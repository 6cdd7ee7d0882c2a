"""Scripts of velocities as motions: what is asked for when, and what is no script."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.commands.velocity import FORMAT
from adapters.motions import velocities
from adapters.motions.load import expect, load
from station.errors import BadFile, ConfigError, UnknownName, UsageError
from station.motion.playback import Playback

COMMAND = FORMAT.for_robot("go2")
SCRIPT = """
velocities:
  - {seconds: 2, vx: 0.5}
  - {seconds: 1.5, vy: -0.2, wz: 0.8}
  - {seconds: 1}
"""


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "patrol.velocity"
    path.write_text(SCRIPT)
    return path


def asked(reference: str, time_s: float) -> list[float]:
    motion = load(reference)
    return COMMAND.encode(motion.at(time_s), motion.joint_names).tolist()


def test_each_segment_is_asked_for_from_its_beginning_to_its_end(script: Path) -> None:
    assert load(script).duration_s == 4.5
    found = [asked(str(script), time_s) for time_s in (-1.0, 0.0, 1.99, 2.0, 3.49, 3.5, 4.5, 100.0)]
    forward, turning, still = [0.5, 0.0, 0.0], [0.0, -0.2, 0.8], [0.0, 0.0, 0.0]
    np.testing.assert_allclose(found, [forward, forward, forward, turning, turning, still, still, still], atol=1e-15)


def test_the_manifest_gets_file_hash_and_segments(script: Path) -> None:
    facts = load(script).facts()
    assert facts["file"] == str(script)
    assert len(facts["sha256"]) == 64
    assert facts["segments"][1] == {"seconds": 1.5, "vx": 0.0, "vy": -0.2, "wz": 0.8, "height": 0.0}


def test_played_it_blends_in_steps_between_segments_and_ends_at_zero(script: Path) -> None:
    playback, made = Playback(load(script), COMMAND), []
    while not playback.is_done:
        made.append(playback.step(0.02 if made else 0.0).command)
    commands = np.array(made)
    assert not commands[-1].any()
    steps = np.abs(np.diff(commands, axis=0)).max(axis=1)
    assert (steps > 0.1).sum() == 2, "two changes of segment, and no other jump"
    assert len(commands) * 0.02 == pytest.approx(1.0 + 4.5, abs=0.2), (
        "it stands at the end, so there is nothing to leave"
    )


def test_it_is_seen_in_a_mirror_and_played_slower(script: Path) -> None:
    np.testing.assert_allclose(asked(f"{script}#mirror", 2.5), [0.0, 0.2, -0.8], atol=1e-15)
    np.testing.assert_allclose(asked(f"{script}#speed=0.5", 4.5), [0.0, -0.1, 0.4], atol=1e-15)
    with pytest.raises(UsageError, match="it says velocities and no joints"):
        load(f"{script}#retarget=1.7")


@pytest.mark.parametrize("name", velocities.names())
def test_each_that_is_built_in_is_found_by_its_name_and_begins_and_ends_standing(name: str) -> None:
    expect(f"velocity:{name}")
    motion = load(f"velocity:{name}")
    for time_s in (0.0, motion.duration_s):
        assert not COMMAND.encode(motion.at(time_s), ()).any()


def test_the_built_in_ones_are_those_that_the_docs_name() -> None:
    assert velocities.names() == ["each-axis", "figure-eight", "forward", "stand"]
    eight = load("velocity:figure-eight")
    times = np.arange(0.0, eight.duration_s, 0.02)
    turned = np.cumsum([eight.at(time_s).root_ang_vel[2] * 0.02 for time_s in times])
    assert turned.max() == pytest.approx(2 * np.pi, abs=0.05), "a full circle one way"
    assert turned[-1] == pytest.approx(0.0, abs=0.05), "and one the other way"


@pytest.mark.parametrize("resolve", [load, expect])
def test_an_unknown_script_is_named_with_those_that_there_are(resolve: object) -> None:
    with pytest.raises(UnknownName, match=r"'figure-eigth' \(did you mean 'figure-eight'\?\); known: each-axis"):
        resolve("velocity:figure-eigth")  # type: ignore[operator]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("velocities: []", "velocities is empty"),
        ("velocities: [{vx: 1}]", "seconds"),
        ("velocities: [{seconds: 1, vx: 50}]", "vx is 50; expected a velocity of at most 10"),
        ("velocities: [{seconds: 1, vx: .nan}]", "vx is nan"),
        ("velocities: [{seconds: 1, height: 74}]", "height is 74; expected a height of the base up to 2 m"),
        ("velocities: [{seconds: 0}]", "seconds is 0; expected 0.1 to 36000 s"),
        ("velocities: [{seconds: 1, speed: 2}]", "speed"),
        ("hello", "patrol.velocity"),
    ],
)
def test_what_is_no_script_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "patrol.velocity"
    path.write_text(text)
    with pytest.raises((BadFile, ConfigError)) as caught:
        load(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
