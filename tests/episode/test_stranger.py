"""An episode of a robot that nothing of ours knows: it is recorded, measured, drawn and exported by what it stated."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station.bus import keys
from station.bus.tap import Write
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.recording import Recording
from station.episode.recorder.resume import reopen, unfinished
from station.view import plots
from station.view.run import read_run
from tests import strider
from tests.adapters.exports.quick_looks import converted
from tests.episode.recorder.test_recording import answer
from tests.episode.writes import Native, foreign
from tests.strider import FEET, KNEES, NAME
from tests.view.pictures import pixels

SECOND = 1_000_000_000
STEPS = 100


def walked(server: Native, begin_ns: int) -> Iterator[Write]:
    """Two seconds of steps, a state before each; the right knee is off by 0.1 rad, and ends beyond its range."""
    for number in range(STEPS):
        at_ns = begin_ns + number * SECOND // 50
        asked = np.array([np.sin(number / 10) / 2, 1.45 if number > STEPS // 2 else 0.2])
        lag = np.array([0.0, 0.1])
        yield server.write(keys.robot_state(NAME), strider.state(asked + lag), written_ns=at_ns)
        for key, value in strider.step(number, asked).items():
            yield server.write(key, value, written_ns=at_ns + SECOND // 100)
        yield foreign(FEET, b"[12.5, 13.5]")


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> EpisodeReader:
    recording = Recording(
        RecordingOptions(data=tmp_path_factory.mktemp("data"), min_free_mb=0.0), backend="replication",
        is_lossless=True, bus="unix:///x",
    )  # fmt: skip
    walker, cli = Native("walker"), Native("record")
    begin_ns = time.monotonic_ns()
    stated = walker.json(keys.server_config("walker"), **strider.facts())
    recording.feed([walker.json(keys.server("walker"), name="walker", role="low-level", state="active", pid=1), stated])
    recording.feed([cli.request("start", task="walk"), *walked(walker, begin_ns), cli.request("stop")])
    answer(recording)
    folder = Path(answer(recording).path or "")
    recording.close()
    return open_episode(folder)


@pytest.fixture(scope="module")
def quality(reader: EpisodeReader) -> Quality:
    return check(reader)


def test_each_key_is_recorded_with_what_its_server_said_of_it(reader: EpisodeReader) -> None:
    streams = {stream.key: stream for stream in reader.manifest.streams}
    assert {key: streams[key].role for key in (keys.robot_state(NAME), keys.command_used(NAME), FEET)} == {
        keys.robot_state(NAME): "state", keys.command_used(NAME): "policy", FEET: "state",
    }  # fmt: skip
    recorded = reader.recorded[FEET]
    assert recorded is not None
    assert [element.title for element in recorded.elements] == ["left_force [N]", "right_force [N]"]
    assert reader.vectors(keys.robot_state(NAME)).values.shape == (STEPS, 11)
    assert reader.known.robot(NAME) == strider.DESCRIPTION
    assert reader.manifest.robot.suffix == NAME
    assert "-strider-walk-" in reader.episode_id


def test_its_steps_joints_and_limits_are_measured(quality: Quality) -> None:
    (of_steps,), (moved,) = quality.steps, quality.motion
    assert (of_steps.robot, of_steps.compared_steps, of_steps.worst_joint) == (NAME, STEPS, "right_knee")
    assert of_steps.worst_joint_error_rad == pytest.approx(0.1)
    assert (moved.state_key, moved.command_key) == (keys.robot_state(NAME), keys.command_used(NAME))
    assert moved.limits_from == "description of strider"
    assert list(moved.limit_joints) == ["right_knee"]
    assert moved.beyond_limit_rad == pytest.approx(0.05)


def test_its_state_can_be_read_as_a_policy_reads_it(reader: EpisodeReader) -> None:
    message = next(reader.messages([keys.robot_state(NAME)]))
    state = steps.robot_state(reader.contract(message.topic), message.data)
    assert state is not None
    assert (state.q.shape, state.dq.shape, state.quat_wxyz.tolist()) == ((2,), (2,), [1.0, 0.0, 0.0, 0.0])


def test_its_limbs_are_drawn(reader: EpisodeReader, quality: Quality, tmp_path: Path) -> None:
    run = read_run(reader)
    assert (run.robot, run.groups, run.can_fall) == (NAME, strider.DESCRIPTION.groups, True)
    assert run.commanded is not None
    assert run.commanded.names == KNEES
    errors = quality.joint_errors_rad(NAME)
    page = pixels(plots.save_run(run, errors, tmp_path / "plot.png"))
    assert (run.has_place, run.heights) == (False, None)
    with_height = pixels(plots.save_run(replace(run, has_place=True), errors, tmp_path / "placed.png"))
    assert len(page) < len(with_height), "no empty panel where nothing measures a height"


def test_its_columns_are_named_in_exports(reader: EpisodeReader, tmp_path: Path) -> None:
    converted("csv", reader.folder, tmp_path / "out")
    header = next((tmp_path / "out").rglob(f"{FEET}.csv")).read_text().splitlines()[0]
    assert header.split(",")[-2:] == ["left_force [N]", "right_force [N]"]


def test_a_robot_that_comes_while_an_episode_is_recorded_has_names_too(tmp_path: Path) -> None:
    recording = Recording(
        RecordingOptions(data=tmp_path, min_free_mb=0.0), backend="replication", is_lossless=True, bus="unix:///x"
    )
    walker, cli = Native("walker"), Native("record")
    recording.feed([cli.request("start")])
    answer(recording)
    recording.feed([walker.json(keys.server_config("walker"), **strider.facts()), foreign(FEET, b"[1.0, 2.0]"),
                    cli.request("stop")])  # fmt: skip
    reader = open_episode(Path(answer(recording).path or ""))
    recording.close()
    assert reader.recorded[FEET] == reader.known.get(FEET) is not None


@pytest.mark.usefixtures("processes")
def test_a_recorder_that_takes_an_episode_up_again_still_knows_its_robot(reader: EpisodeReader, tmp_path: Path) -> None:
    from station.bus.tap import Position
    from tests.episode.recorder.test_resume import BUS, finish, killed

    folder = tmp_path / "walk" / "2026-11-21-strider-walk-0001"
    killed(folder, [foreign("before", b"1")], servers={"walker": strider.facts()})
    found = unfinished(folder, BUS)
    assert found is not None
    taken = reopen(found, RecordingOptions(data=tmp_path), place=found.point.position, is_exact=True)
    taken.take.writer.put([foreign(FEET, b"[1.0, 2.0]")], position=Position("id", 10_000, 0))
    finish(taken.take.writer)
    again = open_episode(folder)
    assert again.recorded == {"before": None, FEET: reader.recorded[FEET]}


def test_a_description_is_short_in_a_manifest(reader: EpisodeReader) -> None:
    stated = reader.manifest.servers["walker"]["description"]
    assert len(json.dumps(stated)) < 6000
    assert reader.manifest.shortened == {}
