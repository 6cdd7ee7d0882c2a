"""An episode as a Rerun file, read back: robot, reference, named curves, states and events on one time line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station import depth
from station.bus import codec, keys
from station.episode.reading.reader import open_episode
from station.errors import BadFile, StationError
from station.point_cloud import decoded, encoded, voxels, xyz
from station.view.episode_rrd import save
from station.view.layout import TIMELINE
from tests.episode import lock_step
from tests.episode.filming import cloud
from tests.episode.synthetic import ROBOT, STANDING, EpisodeBuilder, command, tick, walk
from tests.export.pictured import depth_steps, jpeg
from tests.view import arms
from tests.view.robots import tiny
from tests.view.rrd import Recorded, verify

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path / "data")


def test_file_is_sound_and_holds_the_robot_and_its_reference(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.5)
    path = tmp_path / "ep.rrd"
    view = save(open_episode(builder.finish()), path, robot_model=tiny(tmp_path))
    verify(path)
    recorded = Recorded(path)
    assert view.poses == 25
    assert {"world/robot/pelvis", "world/robot/left_knee", "world/reference/pelvis"} <= recorded.entities
    assert recorded.rows("world/robot/pelvis") == 25
    assert [path.name for path in tmp_path.iterdir() if "part" in path.name] == []


def test_poses_are_those_of_the_episode_beside_each_other(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number in range(5):
        tick(builder, number, at_s=0.1 * number, asked=command(height=0.6), height=0.75)
    path = tmp_path / "ep.rrd"
    save(open_episode(builder.finish()), path, robot_model=tiny(tmp_path))
    recorded = Recorded(path)
    robot = np.array(recorded.column("world/robot/pelvis", ":translation")).reshape(-1, 3)
    ghost = np.array(recorded.column("world/reference/pelvis", ":translation")).reshape(-1, 3)
    assert robot[:, 0] == pytest.approx(0.02 * np.arange(5))
    assert robot[:, 2] == pytest.approx(np.full(5, 0.75))
    assert ghost - robot == pytest.approx(np.tile([0.0, 0.9, -0.15], (5, 1)), abs=1e-6)


def test_a_camera_is_drawn_where_it_is_mounted(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.5)
    for name in ("knee", "room", "broken"):
        builder.write({keys.camera_image(name): jpeg(1)}, at_s=0.3, writer=name)
    inner = {"width": 160, "height": 96, "fx": 100.0, "fy": 101.0, "cx": 79.5, "cy": 47.5}
    mount = {"parent": "left_knee", "position_m": [0.1, 0.0, 0.2], "quat_wxyz": [0.5, -0.5, 0.5, -0.5]}
    stated: dict[str, dict[str, Any]] = {
        "knee": {"intrinsics": inner, "mount": mount},
        "room": {"intrinsics": inner, "mount": mount | {"parent": "wall"}},
        "broken": {"intrinsics": inner | {"fx": 0.0}},
    }
    servers = {name: {"key": keys.camera_image(name), **facts} for name, facts in stated.items()}
    episode, path = open_episode(builder.finish({"servers": servers})), tmp_path / "ep.rrd"
    view = save(episode, path, robot_model=tiny(tmp_path))
    verify(path)
    recorded, entity = Recorded(path), "world/robot/left_knee/knee"
    assert [name for name in recorded.entities if name.endswith(("knee/knee", "room", "broken"))] == [entity]
    (matrix,) = recorded.column(entity, ":image_from_camera")
    assert np.reshape(matrix, (3, 3)).T.tolist() == [[100.0, 0.0, 79.5], [0.0, 101.0, 47.5], [0.0, 0.0, 1.0]]
    assert np.ravel(recorded.column(entity, ":resolution")).tolist() == [160.0, 96.0]
    assert np.ravel(recorded.column(entity, ":translation")) == pytest.approx([0.1, 0.0, 0.2])
    assert np.ravel(recorded.column(entity, ":quaternion")).tolist() == [-0.5, 0.5, -0.5, 0.5], "x y z w"
    (told,) = [warning for warning in view.warnings if "broken" in warning]
    assert "fx is 0; expected a focal length above 0 px" in told


def test_depth_lies_below_its_camera_in_the_scene_in_millimetres(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.5)
    for number in range(3):
        for name in ("knee", "room"):
            builder.write({keys.camera_depth(name): depth.encoded(depth_steps(number))}, at_s=0.1 * number, writer=name)
    inner = {"width": 160, "height": 96, "fx": 100.0, "fy": 101.0, "cx": 79.5, "cy": 47.5}
    mount = {"parent": "left_knee", "position_m": [0.1, 0.0, 0.2], "quat_wxyz": [0.5, -0.5, 0.5, -0.5]}
    servers = {
        "knee": {"key": keys.camera_image("knee"), "depth": {"key": keys.camera_depth("knee")}, "intrinsics": inner,
                 "mount": mount},
    }  # fmt: skip
    builder.write({keys.camera_image("knee"): jpeg(1)}, at_s=0.3, writer="knee")
    path = tmp_path / "ep.rrd"
    save(open_episode(builder.finish({"servers": servers})), path, robot_model=tiny(tmp_path))
    verify(path)
    recorded = Recorded(path)
    for entity in ("world/robot/left_knee/knee/depth", "depth/room"):
        blobs = recorded.column(entity, "EncodedDepthImage:blob")
        assert [bytes(blob[0]) for blob in blobs] == [depth.encoded(depth_steps(number)) for number in range(3)]
        assert np.ravel(recorded.column(entity, "EncodedDepthImage:meter")).tolist() == [1000.0] * 3
        assert recorded.seconds(entity, TIMELINE) == pytest.approx([0.0, 0.1, 0.2], abs=0.001)


def test_clouds_lie_on_the_body_that_their_lidar_is_mounted_on_twice_a_second(
    builder: EpisodeBuilder, tmp_path: Path
) -> None:
    walk(builder, seconds=1.0)
    for number in range(10):
        for name, frame in (("top", "head"), ("room", "world"), ("loose", "livox")):
            value = encoded(decoded(cloud(number))._replace(frame=frame))
            builder.write({keys.lidar_cloud(name): value}, at_s=0.1 * number, writer=name)
    builder.write({keys.lidar_cloud("bad"): b"none"}, at_s=0.5, writer="bad")
    path = tmp_path / "ep.rrd"
    save(open_episode(builder.finish({})), path, robot_model=tiny(tmp_path))
    verify(path)
    recorded = Recorded(path)
    assert {name for name in recorded.entities if name.endswith(("top", "room", "loose", "bad"))} == {
        "world/robot/head/top", "world/room", "clouds/loose",
    }  # fmt: skip
    for entity in ("world/robot/head/top", "clouds/loose"):
        first, second = recorded.column(entity, "Points3D:positions")
        assert np.asarray(first) == pytest.approx(voxels(xyz(decoded(cloud(0)))))
        assert len(second) > 50
        assert recorded.seconds(entity, TIMELINE) == pytest.approx([0.0, 0.5], abs=0.001)


def test_time_line_is_seconds_since_the_start_of_the_episode(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number in range(5):
        tick(builder, number, at_s=0.1 * number)
    path = tmp_path / "ep.rrd"
    save(open_episode(builder.finish()), path)
    seconds = Recorded(path).seconds(f"curves/state/{keys.robot_state(ROBOT)}/angle", TIMELINE)
    assert seconds == pytest.approx(0.1 * np.arange(5) + 0.0002, abs=1e-6)


def test_curves_have_the_names_and_units_of_the_contract(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.2)
    path = tmp_path / "ep.rrd"
    view = save(open_episode(builder.finish()), path)
    recorded = Recorded(path)
    entity = f"curves/command/{twist_keys.action_body()}"
    assert recorded.column(f"{entity}/position", "SeriesLines:names") == [["root_height [m]"]]
    angles = recorded.column(f"{entity}/angle", "SeriesLines:names")[0]
    assert angles[:3] == ["root_roll [rad]", "root_pitch [rad]", "left_hip_pitch_pos [rad]"]
    values = recorded.column(f"{entity}/angle", "Scalars:scalars")
    assert len(values) == 10
    assert values[0][2:] == pytest.approx(STANDING)
    assert set(view.curves) <= recorded.entities


def test_each_joint_is_shown_as_commanded_and_as_measured(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.2, asked=command(STANDING + 0.1))
    path = tmp_path / "ep.rrd"
    save(open_episode(builder.finish()), path)
    recorded = Recorded(path)
    for joint in G1_29:
        commanded = np.array(recorded.column(f"joints/{joint}/commanded", "Scalars:scalars"))
        measured = np.array(recorded.column(f"joints/{joint}/measured", "Scalars:scalars"))
        assert commanded - measured == pytest.approx(np.full((10, 1), 0.1))


def test_gate_motion_and_events_are_told(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number in range(20):
        tick(builder, number, at_s=0.02 * number, gate="entering" if number < 10 else "tracking")
    builder.event("fall", at_s=0.3, severity="error", tilt_rad=1.23456, contacts=["torso_link"])
    path = tmp_path / "ep.rrd"
    view = save(open_episode(builder.finish()), path)
    recorded = Recorded(path)
    assert recorded.column("states/gate", "StateChange:state") == [["entering"], ["tracking"]]
    assert recorded.column("states/motion", "StateChange:state") == [["playing"]]
    assert recorded.column("events", "TextLog:text") == [["g1: fall tilt_rad=1.235 contacts=['torso_link']"]]
    assert recorded.column("events", "TextLog:level") == [["ERROR"]]
    assert view.events == 1


def test_what_an_operator_moves_is_told_as_a_state_until_he_lets_go(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number, (mode, is_engaged) in enumerate(
        [("tool", False), ("tool", True), ("joints 1-4", True), ("tool", False)]
    ):
        source = {"kind": "operator", "driver": "arm-tcp", "mode": mode, "engaged": is_engaged}
        values = arms.values(arms.START, asked=arms.START)
        values[keys.command_source(arms.ROBOT)] = codec.json_object(source)
        builder.write(values, at_s=0.1 * number, writer="teleop")
    save(open_episode(builder.finish()), tmp_path / "ep.rrd")
    states = Recorded(tmp_path / "ep.rrd").column("states/motion", "StateChange:state")
    assert states == [["released"], ["tool"], ["joints 1-4"], ["released"]]


def test_where_the_model_that_ran_is_not_here_the_built_in_one_is_drawn_and_a_warning_says_so(
    builder: EpisodeBuilder, tmp_path: Path
) -> None:
    walk(builder, seconds=0.2)
    facts = {"model": "/elsewhere/g1_meshed.xml", "model_sha256": "5b583d20a469b426"}
    manifest = {"servers": {"g1": {"robot": ROBOT, "robot_facts": facts}}}
    view = save(open_episode(builder.finish(manifest)), tmp_path / "ep.rrd")
    assert view.poses == 10
    (warning,) = view.warnings
    assert "which is not the model that ran (/elsewhere/g1_meshed.xml, sha256 5b583d20a469" in warning


def test_episode_of_stock_scripts_has_curves_and_a_robot(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number in range(10):
        state = np.concatenate([np.zeros(5), STANDING])
        builder.foreign(twist_keys.action_body(), codec.json_vector(command()), at_s=0.02 * number)
        builder.foreign(twist_keys.state_body(ROBOT), codec.json_vector(state), at_s=0.02 * number + 0.01)
    view = save(open_episode(builder.finish()), tmp_path / "ep.rrd", robot_model=tiny(tmp_path))
    assert view.poses == 10
    assert "world/reference/pelvis" in Recorded(tmp_path / "ep.rrd").entities


def test_model_that_the_user_names_must_be_there(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.2)
    reader = open_episode(builder.finish())
    with pytest.raises(BadFile, match=r"none\.xml"):
        save(reader, tmp_path / "ep.rrd", robot_model=tmp_path / "none.xml")
    assert not (tmp_path / "ep.rrd").exists()


def test_folder_that_is_not_there_is_one_line(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.2)
    reader = open_episode(builder.finish())
    with pytest.raises(StationError, match="there is no folder") as caught:
        save(reader, tmp_path / "nowhere" / "ep.rrd")
    assert "\n" not in str(caught.value)


def test_real_run_is_drawn_with_the_model_that_it_names(builder: EpisodeBuilder, tmp_path: Path) -> None:
    view = save(open_episode(lock_step.record(builder, seconds=1.0)), tmp_path / "ep.rrd")
    assert (view.poses, view.warnings) == (50, [])
    recorded = Recorded(tmp_path / "ep.rrd")
    assert {"world/robot/torso_link/shape1", "world/reference/left_knee_link"} <= recorded.entities
