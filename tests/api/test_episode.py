"""What a notebook or a script reads of an episode."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import station
from station.bus import codec, keys
from station.contract import TIMING_STAGES, Contract, elements, positions
from station.episode.reading.reader import open_episode
from station.episode.reading.show import count_streams
from station.errors import EpisodeError, UnknownName
from tests.api.libraries import needs
from tests.episode.synthetic import MONO_START_NS, ROBOT, STANDING, WALL_START_NS, EpisodeBuilder, walk
from tests.export.pictured import number_in, pose, shoot, walked

STATE = keys.robot_state(ROBOT)
STRIDER = "strider"
LEGS = ("front_knee", "rear_knee")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An episode of 25 steps and 15 pictures; see `tests.export.pictured.walked`."""
    return Path(walked(tmp_path_factory.mktemp("data"), seconds=0.5).folder)


@pytest.fixture
def episode(folder: Path) -> station.Episode:
    return station.open_episode(folder)


def contract(key: str, **fields: object) -> Contract:
    return Contract(key=key, family="station", rate_hz=50.0, **fields)  # type: ignore[arg-type]


def stride(builder: EpisodeBuilder, *, steps: int = 3) -> None:
    """Record steps of a robot with two joints that nothing but the contracts in the file knows of."""
    state = elements((positions(LEGS), "rad"), (tuple(f"{leg}_vel" for leg in LEGS), "rad/s"))
    command = elements((("forward_vel",), "m/s"))
    timing = elements((("tick", "command_seq", *TIMING_STAGES), ""))
    builder.contracts |= {
        one.key: one
        for one in (
            contract(keys.robot_state(STRIDER), role="state", codec="f64", elements=state),
            contract(keys.command_used(STRIDER), role="policy", codec="f64", elements=command),
            contract(keys.policy_timing(STRIDER), role="policy", codec="json-vector", elements=timing),
        )
    }
    for number in range(steps):
        at_s = 0.5 + 0.02 * number
        builder.write({keys.robot_state(STRIDER): codec.f64([number, 0.1, 0.0, 0.0])}, at_s=at_s, writer="legs")
        timing_row = [number, 0, 0, 0, *(MONO_START_NS + round(at_s * 1e9) + ns for ns in (0, 10, 20, 30))]
        results = {
            keys.command_used(STRIDER): codec.f64([0.5]),
            keys.policy_timing(STRIDER): codec.json_vector(timing_row),
        }
        builder.write(results, at_s=at_s + 0.003, writer="legs")


def test_an_episode_is_opened_as_the_newest_or_by_id_or_path(folder: Path, tmp_path: Path) -> None:
    data, name = folder.parents[1], folder.name
    for how in ("latest", name, name[:-4], f"walk/{name}"):
        assert station.open_episode(how, data).folder == folder
        assert station.open_episode(how, data=str(data)).id == name
    assert station.open_episode(folder / "signals.mcap").folder == station.open_episode(str(folder)).folder == folder
    with pytest.raises(
        station.StationError, match=r"'latest': not found in /.*/none, which holds 0 .*record one, or name"
    ):
        station.open_episode("latest", tmp_path / "none")


def test_numbers_have_names_units_and_times_on_both_clocks(episode: station.Episode) -> None:
    table = episode.numpy(STATE)
    assert table.values.shape == (25, 65)
    assert table.values.dtype == np.float64
    assert np.array_equal(table.values[:, :29], [pose(number) for number in range(25)])
    assert np.array_equal(table["left_hip_pitch_pos"], table.values[:, 0])
    assert dict(zip(table.names, table.units, strict=True))["left_knee_vel"] == "rad/s"
    assert table.written_s[:2].tolist() == pytest.approx([0.1, 0.12])
    assert table.time_s[:2].tolist() == pytest.approx([0.1002, 0.1202])
    assert episode.wall_ns(table.time_s)[1] == WALL_START_NS + 120_200_000
    assert episode.mono_ns(table.time_s)[1] == MONO_START_NS + 120_200_000


def test_columns_are_chosen_by_name_or_pattern_in_the_order_of_the_key(episode: station.Episode) -> None:
    table = episode.numpy(STATE, "gyro_*", "left_knee_pos")
    assert table.names == ("left_knee_pos", "gyro_x", "gyro_y", "gyro_z")
    assert table.units == ("rad", *["rad/s"] * 3)
    assert np.array_equal(table.values[0], [STANDING[3], 0, 0, 0])
    with pytest.raises(
        station.StationError, match=r"unknown column of robot_state_.*'\*_poz'.*; known: .*left_knee_pos"
    ):
        episode.numpy(STATE, "*_poz")


def test_a_key_may_be_named_by_its_beginning_or_a_pattern_where_that_fits_but_one(episode: station.Episode) -> None:
    whole = episode.numpy(f"robot_state_{episode.robots[0]}")
    for short in ("robot_state", "robot_sta*"):
        assert episode.numpy(short).key == whole.key
        assert list(episode.pandas(short)) == list(whole.names)
    with pytest.raises(EpisodeError, match=r"'\*' fits \d+ keys, .*robot_state_.*; name one"):
        episode.numpy("*")
    with pytest.raises(UnknownName, match=r"unknown key of .* 'robot_st'"):
        episode.numpy("robot_st")


def test_numbers_that_the_recording_does_not_name_are_called_by_their_place(episode: station.Episode) -> None:
    assert episode.numpy(keys.policy_obs(ROBOT)).names == tuple("01234567")


def test_a_robot_that_the_station_has_never_heard_of_has_its_names_and_units(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    stride(builder)
    episode = station.open_episode(builder.finish())
    assert episode.robots == [STRIDER]
    (state,) = (stream for stream in episode.streams if stream.key == keys.robot_state(STRIDER))
    assert (state.names, state.units[2], state.nominal_rate_hz) == (
        ("front_knee_pos", "rear_knee_pos", "front_knee_vel", "rear_knee_vel"), "rad/s", 50.0,
    )  # fmt: skip
    table = episode.numpy(keys.robot_state(STRIDER), "*_pos")
    assert (table.names, table.units) == (("front_knee_pos", "rear_knee_pos"), ("rad", "rad"))
    steps = episode.steps()
    assert steps.state["front_knee_pos"].tolist() == [0.0, 1.0, 2.0]
    assert (steps.command.names, steps.command.units) == (("forward_vel",), ("m/s",))
    assert steps.observation.values.shape == (3, 0)
    assert np.isnan(steps.timing["command_written"]).all()  # a zero of the recording: nothing knows when


def test_policy_steps_are_rows_of_what_was_seen_asked_and_done(episode: station.Episode) -> None:
    steps = episode.steps()
    count = np.arange(25)
    assert steps.number.tolist() == (count + 1).tolist()
    assert steps.time_s == pytest.approx(0.1035 + count / 50)
    assert set(steps.gate) == {"tracking"}
    assert steps.state["left_hip_pitch_pos"] == pytest.approx(count / 1000)
    assert steps.command["left_hip_pitch_pos"] == pytest.approx(0.5 + count / 1000)
    assert np.array_equal(steps.observation.values, np.arange(8) + count[:, None])
    assert np.array_equal(steps.action.values[:, 0], np.float32(0.1 * count))
    assert np.array_equal(steps.target["left_knee_kp"], np.full(25, 100.0))
    assert steps.timing["state_read"] == pytest.approx(0.1 + count / 50)
    assert steps.timing["sent"] - steps.timing["state_read"] == pytest.approx(0.0032)
    assert len({len(table) for table in steps.parts().values()} | {len(steps)}) == 1


@pytest.mark.filterwarnings("error")
def test_of_policies_that_take_over_each_step_tells_which_drove_and_shows_its_own_observation(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number, (policy, size) in enumerate([("default-pose", 3), ("tracker", 5), ("tracker", 5)]):
        at_s = 0.1 + 0.02 * number
        builder.write({STATE: codec.f64(np.zeros(65))}, at_s=at_s)
        results = {
            keys.policy_obs(ROBOT): codec.f32(np.full(size, number + 1.0)),
            keys.policy_action(ROBOT): codec.f32(np.zeros(29)),
            keys.command_gate(ROBOT): codec.json_object({"state": "tracking", "policy": policy}),
            keys.policy_timing(ROBOT): codec.json_vector([number, 0, *range(6)]),
        }
        builder.write(results, at_s=at_s + 0.003)
    steps = station.open_episode(builder.finish()).steps()
    assert steps.policy.tolist() == ["default-pose", "tracker", "tracker"]
    assert steps.observation.values[:, :3].tolist() == [[1.0] * 3, [2.0] * 3, [3.0] * 3]
    assert np.isnan(steps.observation.values[:, 3:]).tolist() == [[True, True], [False, False], [False, False]]


def test_of_two_robots_in_an_episode_each_has_its_own_steps(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.2)
    stride(builder)
    episode = station.open_episode(builder.finish())
    assert episode.robots == sorted([ROBOT, STRIDER])
    assert (len(episode.steps(ROBOT)), len(episode.steps(STRIDER))) == (10, 3)
    with pytest.raises(station.StationError, match=f"policy steps of {STRIDER} and {ROBOT}; name the robot"):
        episode.steps()
    with pytest.raises(
        station.StationError, match=r"unknown robot with policy steps 'stride' \(did you mean 'strider'\?\)"
    ):
        episode.steps("stride")


def test_values_that_do_not_fit_are_left_out_and_said(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    state = {STATE: codec.f64(np.zeros(64)), keys.robot_state("odd"): b"1"}
    results = {
        keys.command_used(ROBOT): codec.f64(np.zeros(36)),
        keys.policy_timing(ROBOT): b"[1]",
        keys.command_gate(ROBOT): b"{",
    }
    builder.write(state, at_s=0.05)
    builder.write(results, at_s=0.053)
    walk(builder, seconds=0.1)
    episode = station.open_episode(builder.finish())
    with pytest.warns(UserWarning, match=f"{STATE}: 1 of 6 values do not fit"):
        table = episode.numpy(STATE)
    assert (len(table), table.skipped) == (5, 1)
    assert "1 values do not fit" in repr(table)
    with pytest.warns(UserWarning, match="their steps hold NaN") as warned:
        steps = episode.steps()
    assert {str(one.message).partition(":")[0] for one in warned} == {
        STATE, keys.command_used(ROBOT), keys.policy_timing(ROBOT),
    }  # fmt: skip
    assert len(steps) == 6
    assert [np.isnan(table.values[0]).all() for table in steps.parts().values()] == [True] * 6
    assert not np.isnan(steps.command.values[1:]).any()
    assert steps.gate.tolist() == ["", *["tracking"] * 5]
    with pytest.warns(UserWarning, match="1 of 6 values are no JSON"):
        assert len(episode.json(keys.command_gate(ROBOT))) == 5


def test_a_torn_episode_opens_as_far_as_it_goes_and_says_so(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=4.0)
    folder = builder.finish({"timing": {"duration_s": 4.1}}, torn=True)
    file = folder / "signals.mcap.active"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    episode = station.open_episode(folder)
    assert episode.torn is not None
    assert f"torn: {episode.torn}" in repr(episode)
    table = episode.numpy(STATE)
    assert 20 < len(table) < 180
    assert table.time_s[-1] <= episode.duration_s < 3.9
    assert {stream.count for stream in episode.streams if stream.key == STATE} == {len(table)}


def test_a_file_that_was_renamed_since_it_was_opened_is_an_error_of_one_line(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.1)
    folder = builder.finish(torn=True)
    episode = station.open_episode(folder)
    (folder / "signals.mcap.active").rename(folder / "signals.mcap")
    with pytest.raises(station.StationError, match=r"signals.mcap.active: cannot be read: .*; open the episode anew"):
        episode.numpy(STATE)


def test_pictures_come_decoded_or_as_recorded_with_the_time_of_capture(episode: station.Episode) -> None:
    found = list(episode.pictures())
    assert [number_in(picture) for _, picture in found] == list(range(15))
    assert {(picture.shape, picture.dtype) for _, picture in found} == {((96, 160, 3), np.dtype(np.uint8))}
    assert [time_s for time_s, _ in found] == pytest.approx([0.083 + number / 30 for number in range(15)])
    assert all(jpeg.startswith(b"\xff\xd8") for _, jpeg in episode.jpegs("head"))


def test_depth_comes_in_metres_at_the_times_of_its_pictures(tmp_path: Path) -> None:
    episode = station.open_episode(walked(tmp_path, seconds=0.2, has_depth=True).folder)
    assert (episode.cameras, episode.depth_cameras) == (["head"], ["head"])
    found = list(episode.depth())
    assert {(metres.shape, metres.dtype) for _, metres in found} == {((47, 81), np.dtype(np.float32))}
    assert [float(metres[9, 9]) for _, metres in found] == pytest.approx([1.0 + 0.001 * n for n in range(6)])
    assert all((metres[0] == 0.0).all() for _, metres in found), "0 where nothing was measured"
    assert [time_s for time_s, _ in found] == [time_s for time_s, _ in episode.pictures("head")]
    with pytest.raises(station.StationError, match=r"holds pictures, no numbers; episode.depth\('head'\) reads it"):
        episode.numpy("camera_depth_head")


def test_who_asks_for_depth_that_is_not_there_is_told(tmp_path: Path, episode: station.Episode) -> None:
    with pytest.raises(station.StationError, match="no camera with depth in it"):
        next(episode.depth())
    deep = station.open_episode(walked(tmp_path, seconds=0.2, has_depth=True, bad_pictures=(1,)).folder)
    with pytest.raises(station.StationError, match=r"unknown camera with depth of .* 'haed'"):
        next(deep.depth("haed"))
    with pytest.warns(UserWarning, match=r"camera head: the depth of 0\.116 s cannot be decoded; left out"):
        assert len(list(deep.depth("head"))) == 5


def test_a_picture_that_cannot_be_decoded_is_left_out_and_said(tmp_path: Path) -> None:
    episode = station.open_episode(walked(tmp_path, seconds=0.1, bad_pictures=(1,)).folder)
    with pytest.warns(UserWarning, match=r"camera head: the picture of 0\.116 s cannot be decoded"):
        assert [number_in(picture) for _, picture in episode.pictures()] == [0, 2]
    assert [jpeg for _, jpeg in episode.jpegs()][1] == b"no picture"


def test_json_and_events_are_lists_with_times(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.1)
    assert station.open_episode(builder.finish()).events() == []
    builder = EpisodeBuilder(tmp_path, number=2)
    builder.event("fall", at_s=1.5, severity="warning", tilt_rad=1.2)
    episode = station.open_episode(builder.finish())
    ((time_s, event),) = episode.events()
    with pytest.raises(station.StationError, match="no policy steps in it"):
        episode.steps(ROBOT)
    assert time_s == pytest.approx(1.5002)
    assert (event["name"], event["detail"]) == ("fall", {"tilt_rad": 1.2})


def test_streams_tell_what_each_key_holds_and_how_often_it_was_written(episode: station.Episode, folder: Path) -> None:
    streams = {stream.key: stream for stream in episode.streams}
    assert sorted(streams) == episode.keys
    state, gate = streams[STATE], streams[keys.command_gate(ROBOT)]
    assert (state.holds, state.role, state.writer, state.count, state.lost) == ("numbers", "state", "g1", 25, 0)
    assert (state.nominal_rate_hz, state.rate_hz) == (50.0, pytest.approx(50.0))
    assert (state.names[0], state.units[0]) == ("left_hip_pitch_pos", "rad")
    assert (gate.holds, gate.names, streams["camera_image_head"].holds) == ("json", (), "pictures")
    assert {stream.key: stream.count for stream in count_streams(open_episode(folder))} == {
        key: stream.count for key, stream in streams.items()
    }


def test_counts_of_a_finished_episode_are_those_of_its_recorder(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    builder.write({"own": b"{}"}, at_s=0.1, writer="x")
    folder = builder.finish()
    (counted,) = count_streams(open_episode(folder))
    listed = {"key": "own", "source": counted.source, "writer": "x", "count": 1, "lost": 7}
    (folder / "manifest.yaml").write_text(f"streams: [{listed}]")
    assert [stream.lost for stream in station.open_episode(folder).streams] == [7]
    (folder / "signals.mcap").rename(folder / "signals.mcap.active")
    assert [stream.lost for stream in station.open_episode(folder).streams] == [0]
    (folder / "signals.mcap.active").rename(folder / "signals.mcap")
    (folder / "manifest.yaml").write_text(f"streams: [{listed | {'key': 'other'}}]")
    assert [(stream.key, stream.lost) for stream in station.open_episode(folder).streams] == [("own", 0)]


def test_what_cannot_be_read_as_numbers_says_why_and_what_to_do(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.1)
    builder.foreign("notes", b"no JSON", at_s=0.1)
    shoot(builder, 1, at_s=0.1)
    builder.delete("gone", at_s=0.1)
    episode = station.open_episode(builder.finish())
    gate, mistaken = keys.command_gate(ROBOT), STATE[:-1]
    for key, why in {
        mistaken: rf"unknown key of .* \(did you mean '{STATE}'\?\); known: action_body_.*, target_",
        "gone": "unknown key of .* 'gone'",
        gate: rf"'{gate}' holds json, no numbers; episode.json\('{gate}'\)",
        "camera_image_head": r"holds pictures, no numbers; episode.pictures\('head'\)",
        "notes": r"has no contract, so nothing says what its numbers are; episode.raw\('notes'\)",
    }.items():
        with pytest.raises(station.StationError, match=why):
            episode.numpy(key)
    assert list(episode.raw("notes")) == [(pytest.approx(0.1), b"no JSON")]
    with pytest.raises(station.StationError, match=r"unknown camera of .* 'hand' .*; known: head"):
        next(episode.pictures("hand"))


def test_frames_hold_steps_and_json_too(episode: station.Episode, tmp_path: Path) -> None:
    needs("pandas", "polars")
    frame = episode.steps().pandas()
    assert (frame.index.name, len(frame)) == ("time_s", 25)
    assert frame["command.left_hip_pitch_pos"].iloc[2] == pytest.approx(0.502)
    assert frame.attrs["units"]["state.left_knee_vel"] == "rad/s"
    assert {"gate", "number", "observation.7", "timing.sent"} <= set(frame.columns)
    assert episode.steps().polars().columns == ["time_s", *frame.columns]
    columns = episode.polars(STATE, "gyro_*").columns
    assert columns == ["time_s", "gyro_x", "gyro_y", "gyro_z"]
    builder = EpisodeBuilder(tmp_path)
    for number, value in enumerate((b'{"a": 1, "time_s": 2}', b'{"a": 1.5, "b": [1]}', b'"x"')):
        builder.write({"own": value}, at_s=0.1 * number, lag_s=0.0)
    own = station.open_episode(builder.finish())
    assert list(own.pandas("own").columns) == ["a", "time_s.2", "b", "value"]
    assert own.polars("own").to_dict(as_series=False) == {
        "time_s": [0.0, 0.1, 0.2], "a": [1.0, 1.5, None], "time_s.2": [2, None, None], "b": [None, "[1]", None],
        "value": [None, None, "x"],
    }  # fmt: skip


def test_a_library_that_is_not_installed_is_named_with_the_extra(
    episode: station.Episode, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "polars"):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(
            station.StationError, match=rf"{name} frame needs {name} .*; pip install 'teleop-station\[fr"
        ):
            getattr(episode, name)(STATE)


def test_an_episode_prints_as_task_length_robots_and_streams(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=1.0)
    builder.event("fall", at_s=0.5)
    builder.foreign("own\x1b[2J", b"1", at_s=0.5)
    folder = builder.finish({"quality": {"verdict": "usable"}, "timing": {"duration_s": 12.3}})
    text = repr(station.open_episode(folder))
    assert text.startswith(f"episode {folder.name}: task walk, 12.3 s, usable, {ROBOT}\n")
    assert re.search(rf"^  {STATE} +65 numbers +50.0 Hz +50 × g1$", text, re.MULTILINE)
    assert r"own\x1b[2J" in text
    assert text.endswith("\n  and 1 more of the roles control and event, in episode.streams")
