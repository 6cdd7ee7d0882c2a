"""What pictures read of an episode: postures, gate, clips, falls, and what is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.episode.reading.reader import open_episode
from station.view import plot_style as style
from station.view.run import Run, read_run
from tests.episode.synthetic import ROBOT, STANDING, EpisodeBuilder, command, tick, walk
from tests.view import arms

LYING = (0.6, 0.8, 0.0, 0.0)  # 106° about x


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path / "data")


def read(builder: EpisodeBuilder, manifest: dict[str, Any] | None = None) -> Run:
    return read_run(open_episode(builder.finish(manifest)))


def test_gate_and_phases_are_spans_from_change_to_change(builder: EpisodeBuilder) -> None:
    for number in range(50):
        tick(builder, number, at_s=0.02 * number, gate="entering" if number < 20 else "tracking",
             phase="entering" if number < 20 else "playing")  # fmt: skip
    run = read(builder)
    assert [span.name for span in run.gate] == ["entering", "tracking"]
    assert run.gate[0].end_s == run.gate[1].start_s == pytest.approx(0.4, abs=0.01)
    assert [span.name for span in run.phases] == ["entering", "playing"]
    assert run.end_s == pytest.approx(0.98, abs=0.01)


def test_of_several_policies_it_shows_which_drove_when(builder: EpisodeBuilder) -> None:
    for number in range(30):
        gate = {"state": "tracking", "policy": "walks" if number < 10 or number >= 20 else "tracks"}
        values = {keys.command_gate(ROBOT): codec.json_object(gate), keys.policy_obs(ROBOT): bytes(4)}
        builder.write(values, at_s=0.02 * number)
    run = read(builder)
    assert [span.name for span in run.driving] == ["walks", "tracks", "walks"]
    assert [span.name for span in run.gate] == ["tracking"]


def test_clips_take_the_place_of_playing(builder: EpisodeBuilder) -> None:
    for number in range(20):
        source = {"file": "builtin:tour", "phase": "playing", "time_s": 0.1 * number}
        values = {
            twist_keys.action_body(): codec.json_vector(command()),
            keys.command_source(ROBOT): codec.json_object(source),
        }
        builder.write(values, at_s=0.1 * number, writer="motion")
    parts = [{"name": "wave", "start_s": 0.0, "end_s": 1.0}, {"name": "bow", "start_s": 1.0, "end_s": 1.5}]
    facts = {"file": "builtin:tour", "duration_s": 2.0, "clips": parts}
    run = read(builder, {"servers": {"motion": {"robot": ROBOT, "motion": facts}}})
    assert [span.name for span in run.phases] == ["wave", "bow", "tour"]
    assert run.motion == "tour"


def test_a_fall_is_seen_once_though_told_and_derived(builder: EpisodeBuilder) -> None:
    for number in range(100):
        tick(builder, number, at_s=0.02 * number, quat=LYING if number >= 50 else (1.0, 0, 0, 0))
    builder.event("fall", at_s=0.95, severity="error")
    assert read(builder).falls_s == [pytest.approx(0.95, abs=0.01)]


def test_an_episode_of_stock_scripts_gives_its_command_and_its_state(builder: EpisodeBuilder) -> None:
    for number in range(10):
        state = np.concatenate([np.zeros(5), STANDING])
        builder.foreign(twist_keys.action_body(), codec.json_vector(command()), at_s=0.02 * number)
        builder.foreign(twist_keys.state_body(ROBOT), codec.json_vector(state), at_s=0.02 * number + 0.01)
    run = read(builder)
    assert run.commanded is not None
    assert run.joints is not None
    assert run.joints.q[0] == pytest.approx(STANDING)
    assert not run.has_place
    assert run.gate == []


def test_an_episode_without_a_robot_has_its_command_alone(builder: EpisodeBuilder) -> None:
    builder.write({twist_keys.action_body(): codec.json_vector(command())}, at_s=0.1, writer="motion")
    run = read(builder)
    assert run.measured is None
    assert run.commanded is not None


def test_an_episode_with_nothing_of_a_robot_is_an_empty_run(builder: EpisodeBuilder) -> None:
    builder.event("mark", at_s=0.1)
    run = read(builder)
    assert (run.measured, run.commanded, run.robot, run.end_s) == (None, None, "", 0.0)


def test_a_walk_is_whole(builder: EpisodeBuilder) -> None:
    walk(builder, seconds=0.5)
    run = read(builder)
    assert len(run.times_s) == 25
    assert run.times_s[0] == pytest.approx(0.1, abs=0.01)
    assert run.has_place
    assert run.heights is not None


def test_what_an_operator_moved_is_a_phase_for_as_long_as_he_drove(builder: EpisodeBuilder) -> None:
    for number, (engaged, mode) in enumerate([(False, "tool"), (True, "tool"), (True, "joints 1-4"), (False, "tool")]):
        source = {"kind": "operator", "driver": "arm-tcp", "mode": mode, "engaged": engaged}
        arm = arms.values(arms.START, asked=arms.START)
        builder.write(arm | {keys.command_source(arms.ROBOT): codec.json_object(source)}, at_s=number, writer="teleop")
    run = read(builder)
    assert [(span.name, round(span.end_s - span.start_s)) for span in run.phases] == [("tool", 1), ("joints 1-4", 1)]
    assert not run.can_fall
    assert "fall" not in style.headline(run)


def test_what_is_fixed_to_the_ground_has_no_place_of_its_own_though_its_simulation_tells_one(
    builder: EpisodeBuilder,
) -> None:
    place = {keys.sim_qpos(arms.ROBOT): codec.f64(np.array([0.0, 0.0, 0.0, 1.0, *[0.0] * 10]))}
    for number in range(3):
        builder.write(arms.values(arms.START, asked=arms.START) | place, at_s=number, writer="arm")
    assert not read(builder).has_place
