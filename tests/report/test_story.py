"""What a report tells of an episode is what its pictures show: of arms and of operators as well."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.bus import codec, keys
from station.episode.quality import rule_file
from station.episode.quality.check import check
from station.episode.reading.reader import EpisodeReader, open_episode
from station.report import make, story
from station.report.gather import gather
from station.view.run import Run, read_run
from tests.episode.arm_run import ROBOT as ARM
from tests.episode.arm_run import ArmRun
from tests.episode.synthetic import ROBOT, EpisodeBuilder, tick


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path / "data", task="jog")


def told_as_shown(reader: EpisodeReader) -> tuple[story.Story, Run]:
    """Return what a report and what the pictures read of an episode, which is to be the same where both read it."""
    told, shown = story.read(reader), read_run(reader)
    assert (told.robot, told.gate, told.phases) == (shown.robot, shown.gate, shown.phases)
    return told, shown


def driven_arm(builder: EpisodeBuilder) -> Path:
    """An arm that an operator engages, moves in two ways, and lets go of."""
    run = ArmRun(builder)
    course = (("tool", False, 0.3), ("tool", True, 0.8), ("joints 1-4", True, 0.8), ("joints 1-4", False, 0.3))
    for mode, is_engaged, seconds in course:
        source = {"kind": "operator", "driver": "arm-tcp", "mode": mode, "engaged": is_engaged}
        builder.write({keys.command_source(ARM): codec.json_object(source)}, at_s=run.at_s, writer="teleop")
        (run.move if is_engaged else run.be_silent)(seconds)
    return run.finish()


def test_an_arm_that_an_operator_drives_is_told_with_what_he_moved_and_how_it_followed(builder: EpisodeBuilder) -> None:
    reader = open_episode(driven_arm(builder))
    told, _ = told_as_shown(reader)
    assert told.robot == ARM
    assert [(span.name, round(span.end_s - span.start_s, 1)) for span in told.phases] == [
        ("tool", 0.8), ("joints 1-4", 0.8),
    ]  # fmt: skip
    assert "tracking" in [span.name for span in told.gate]
    assert told.tracks is not None
    assert told.tracks.joints == tuple(f"joint_{number}" for number in range(1, 8))
    assert np.ptp(told.tracks.asked[:, 0]) == pytest.approx(0.48, abs=0.05)  # joint 1 at 0.3 rad/s for 1.6 s
    first, *others = check(reader).joint_errors_rad(ARM).values()
    assert 0.0 < first < 0.03
    assert others == pytest.approx([0.0] * 6)


def test_the_page_of_an_arm_has_its_plot_its_phases_and_its_controller(builder: EpisodeBuilder, tmp_path: Path) -> None:
    found, _ = gather([driven_arm(builder)], rule_file.shipped(), named=True)
    make.write(tmp_path / "r.html", found, [], title="Jog")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert page.count('src="data:image/png') == 1
    for told in ("The arm and its controller", "sim, speed125", ">joints 1-4<", "targets sent in motion"):
        assert told in page, told


@pytest.mark.parametrize("motion", [
    {"file": "builtin:tour", "duration_s": 2.0,
     "clips": [{"name": "wave", "start_s": 0.0, "end_s": 0.5}, {"name": "bow", "start_s": 0.5, "end_s": 0.7}]},
    {"file": "builtin:tour", "duration_s": "long", "clips": [{"name": "wave", "start_s": "soon"}]},
    {"file": "a long name, " * 50},
    "walk",
])  # fmt: skip
def test_a_motion_is_told_as_it_is_shown_whatever_a_manifest_says_of_it(
    builder: EpisodeBuilder, motion: dict[str, Any] | str
) -> None:
    for number in range(50):
        phase, at_s = ("entering" if number < 10 else "playing"), 0.02 * number
        tick(builder, number, at_s=at_s, gate="entering" if number < 10 else "tracking", is_commanded=False)
        source = codec.json_object({"phase": phase, "time_s": at_s})
        builder.write({keys.command_source(ROBOT): source}, at_s=at_s - 0.003, writer="motion")
    _, shown = told_as_shown(open_episode(builder.finish({"servers": {"motion": {"robot": ROBOT, "motion": motion}}})))
    if isinstance(motion, dict) and motion.get("duration_s") == 2.0:
        assert [span.name for span in shown.phases] == ["entering", "wave", "bow", "tour"]
    assert max(len(span.name) for span in shown.phases) <= 80


def test_an_episode_of_two_robots_is_about_the_one_that_its_manifest_names(builder: EpisodeBuilder) -> None:
    arm = ArmRun(builder)
    arm.hold(0.2)
    for number in range(10):
        tick(builder, number, at_s=0.1 + 0.02 * number)
    told, _ = told_as_shown(open_episode(builder.finish({"robot": {"suffix": ROBOT}})))
    assert told.robot == ROBOT
    assert told.tracks is not None
    assert math.isfinite(told.tracks.mean_rad.max())
