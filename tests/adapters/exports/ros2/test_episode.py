from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from adapters.exports.ros2 import kind
from adapters.exports.ros2.topics import Routes
from adapters.robots.g1.joints import G1_29
from station import depth, point_cloud
from station.bus import codec, keys
from station.contract import IMU, Contract, elements
from station.episode.reading.frames import frames
from station.episode.reading.reader import open_episode
from station.errors import EpisodeError
from station.export.columns import key_columns
from station.export.kind import Source
from tests import strider
from tests.adapters.exports.ros2.read_back import connections, exported, read, records, xyz, xyzw
from tests.enrich.recordings import walked
from tests.episode import depth_scenes, filming
from tests.episode.scenes import PICTURES, Shot
from tests.episode.synthetic import ROBOT, WALL_START_NS, EpisodeBuilder, walk

STATE, GATE, TARGET = keys.robot_state(ROBOT), keys.command_gate(ROBOT), keys.target(ROBOT)
VELOCITY = keys.action(f"velocity_{ROBOT}")
TURNED = (np.array([1.0, 2.0, 3.0, 4.0]) / np.sqrt(30.0)).tolist()
"""A rotation, w x y z, of which no two numbers are the same."""
PUSHED = [0.1, -0.2, 0.3, 9.7, -0.5, 0.25]
SAMPLES = np.arange(12.0).reshape(4, 3)
SAMPLED = "state_samples"


@pytest.fixture(scope="module")
def walk_bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A walk with everything that `tests.enrich.recordings.walked` has, and its bag."""
    folder = tmp_path_factory.mktemp("walk")
    episode = walked(folder / "data")
    return episode, exported(episode, folder / "out")[0]


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A robot that leans, is told to walk, and has a lidar, and a sensor with many samples in a write; and its bag."""
    folder = tmp_path_factory.mktemp("turned")
    builder = EpisodeBuilder(folder / "data")
    builder.contracts[SAMPLED] = Contract(
        key=SAMPLED, family="x", role="sensor", codec="f64-rows", elements=elements((("a", "b", "c"), "m"))
    )
    walk(builder, seconds=0.2, quat=TURNED)
    builder.write({VELOCITY: codec.json_vector([0.5, -0.25, 1.5])}, at_s=0.5, writer="teleop")
    builder.write({keys.lidar_imu("top"): codec.f64(PUSHED)}, at_s=0.5, writer="top")
    builder.write({SAMPLED: codec.f64(SAMPLES.ravel())}, at_s=0.5)
    builder.write({SAMPLED: codec.f64(np.zeros(4))}, at_s=0.6)
    episode = builder.finish({"robot": {"suffix": ROBOT}})
    return episode, exported(episode, folder / "out")[0]


def test_joint_states_have_the_names_numbers_and_times_of_the_recording(walk_bag: tuple[Path, Path]) -> None:
    episode, bag = walk_bag
    reader = open_episode(episode)
    found, recorded = read(bag, "/joint_states"), reader.vectors(STATE)
    assert {tuple(one.message.name) for one in found} == {G1_29}
    assert [one.message.position.tolist() for one in found] == recorded.values[:, :29].tolist()
    assert [one.message.velocity.tolist() for one in found] == recorded.values[:, 29:58].tolist()
    assert {len(one.message.effort) for one in found} == {0}
    assert [one.log_ns for one in found] == recorded.log_ns.tolist()
    assert [one.stamp_ns for one in found] == recorded.publish_ns.tolist() != recorded.log_ns.tolist()
    targets = read(bag, "/joint_commands")
    assert [one.message.position.tolist() for one in targets] == reader.vectors(TARGET).values[:, :29].tolist()


def test_every_write_is_a_message_of_each_topic_of_its_key_with_its_times_and_number(
    walk_bag: tuple[Path, Path],
) -> None:
    episode, bag = walk_bag
    reader = open_episode(episode)
    routes, found = Routes(reader).routes, connections(bag)
    assert set(routes) == set(reader.recorded)
    for key, route in routes.items():
        written = [
            (one.log_ns, one.publish_ns, one.sequence) for one in reader.messages([key]) if not one.channel.is_deletion
        ]
        for topic in route.topics:
            assert records(bag, topic.name) == written != []
            assert (found[topic.name].msgcount, found[topic.name].msgtype) == (len(written), topic.type)
    assert set(found) == {topic.name for route in routes.values() for topic in route.topics}


def test_numbers_that_no_other_type_holds_are_arrays_whose_labels_are_the_names_of_the_columns(
    walk_bag: tuple[Path, Path],
) -> None:
    episode, bag = walk_bag
    reader = open_episode(episode)
    found = read(bag, f"/{TARGET}")
    assert [one.message.data.tolist() for one in found] == reader.vectors(TARGET).values.tolist()
    layout = found[0].message.layout
    names = key_columns(reader, TARGET).names
    assert [(one.label, one.size, one.stride) for one in layout.dim] == [
        ("rows", 1, 87), ("columns", 87, 87), *((name, 1, 1) for name in names)
    ]  # fmt: skip
    assert layout.data_offset == 0
    unnamed = read(bag, f"/{keys.policy_obs(ROBOT)}")
    assert unnamed[3].message.data.tolist() == (np.arange(8) + 3).tolist()
    assert f"/{STATE}" not in connections(bag), "joint states and IMU hold all of its numbers"


def test_json_is_text_as_it_was_written(walk_bag: tuple[Path, Path]) -> None:
    episode, bag = walk_bag
    written = [one.data.decode() for one in open_episode(episode).messages([GATE])]
    assert [one.message.data for one in read(bag, f"/{GATE}")] == written
    assert read(bag, "/strange")[0].message.data == "[1, 2]", "a stranger's, which nothing describes"


def test_an_event_is_a_diagnostic_of_its_severity(walk_bag: tuple[Path, Path]) -> None:
    (event,) = read(walk_bag[1], "/diagnostics")
    (status,) = event.message.status
    assert (status.level, status.name, status.hardware_id) == (status.ERROR, "g1: fall", "g1")
    assert status.message == "fall"
    at_ns = WALL_START_NS + 700_000_000
    assert {one.key: one.value for one in status.values} == {"wall_ns": str(at_ns), "lean_rad": "1.25"}
    assert event.stamp_ns == at_ns


def test_a_quaternion_is_turned_from_w_first_to_w_last(turned: tuple[Path, Path]) -> None:
    w, x, y, z = TURNED
    _, bag = turned
    imu, root = read(bag, "/imu")[0], read(bag, "/tf")[2].message.transforms[0]
    assert xyzw(imu.message.orientation) == xyzw(root.transform.rotation) == [x, y, z, w]
    assert (root.header.frame_id, root.child_frame_id, imu.message.header.frame_id) == (
        "world", "base_link", "base_link"
    )  # fmt: skip
    assert xyz(root.transform.translation) == [0.04, 0.0, 0.79]


def test_a_pose_of_the_operator_is_one_in_its_own_frame(walk_bag: tuple[Path, Path]) -> None:
    (head,) = read(walk_bag[1], "/operator_head_pico/pose")
    assert head.message.header.frame_id == "operator"
    assert xyz(head.message.pose.position) == [0.1, -0.2, 1.6]
    assert xyzw(head.message.pose.orientation) == [0.5, -0.5, 0.5, 0.5]


def test_what_an_imu_does_not_measure_says_so_in_its_covariance(turned: tuple[Path, Path]) -> None:
    episode, bag = turned
    body, lidar = read(bag, "/imu")[0].message, read(bag, "/top/imu")[0].message
    recorded = open_episode(episode).vectors(STATE)
    assert xyz(body.angular_velocity) == recorded.values[0, -3:].tolist()
    assert (body.orientation_covariance[0], body.linear_acceleration_covariance[0]) == (0.0, -1.0)
    assert (xyz(lidar.angular_velocity), xyz(lidar.linear_acceleration)) == (PUSHED[:3], PUSHED[3:])
    assert (lidar.orientation_covariance[0], lidar.linear_acceleration_covariance[0]) == (-1.0, 0.0)
    assert lidar.header.frame_id == "top_lidar"
    assert [one.name for one in IMU] == ["gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z"]


def test_a_velocity_command_is_a_twist_in_the_frame_of_the_base(turned: tuple[Path, Path]) -> None:
    (command,) = read(turned[1], "/cmd_vel")
    assert command.message.header.frame_id == "base_link"
    assert xyz(command.message.twist.linear) == [0.5, -0.25, 0.0]
    assert xyz(command.message.twist.angular) == [0.0, 0.0, 1.5]
    assert command.stamp_ns == WALL_START_NS + 500_000_000


def test_many_rows_in_a_write_are_a_table_and_what_is_none_is_counted(
    turned: tuple[Path, Path], tmp_path: Path
) -> None:
    episode, bag = turned
    (found,) = read(bag, f"/{SAMPLED}")
    assert [(one.label, one.size, one.stride) for one in found.message.layout.dim] == [
        ("rows", 4, 12), ("columns", 3, 3), ("a", 1, 1), ("b", 1, 1), ("c", 1, 1)
    ]  # fmt: skip
    assert found.message.data.tolist() == SAMPLES.ravel().tolist()
    assert exported(episode, tmp_path / "out")[1].facts["unfit"] == {SAMPLED: 1}


def test_pictures_are_byte_for_byte_the_recorded_ones_with_the_time_of_capture(tmp_path: Path) -> None:
    scene = filming.Scene()
    episode = tmp_path / "data" / "filmed"
    filming.film(episode, [[scene.picture() for _ in range(3)], scene.signals(2)], scene.anchor)
    bag, _ = exported(episode, tmp_path / "out")
    recorded = list(frames(open_episode(episode), filming.HEAD))
    found = read(bag, "/head/image/compressed")
    assert [one.message.data.tobytes() for one in found] == [one.data for one in recorded]
    assert [(one.stamp_ns, one.log_ns) for one in found] == [(one.captured_ns, one.log_ns) for one in recorded]
    assert {found[0].log_ns - found[0].stamp_ns > filming.EXPOSED_NS} == {True}
    assert {(one.message.format, one.message.header.frame_id) for one in found} == {("jpeg", "head_optical_frame")}


def test_a_cloud_has_every_field_of_every_point_and_its_sensor_a_place(tmp_path: Path) -> None:
    scene = filming.Scene()
    episode = tmp_path / "data" / "scanned"
    filming.film(episode, [[scene.cloud() for _ in range(3)], scene.signals(2)], scene.anchor)
    bag, _ = exported(episode, tmp_path / "out")
    recorded = [point_cloud.decoded(one.data) for one in frames(open_episode(episode), filming.CLOUD)]
    found = read(bag, "/top/points")
    assert [one.message.data.tobytes() for one in found] == [bytes(one.data) for one in recorded]
    first = found[0].message
    assert [(field.name, field.offset, field.datatype, field.count) for field in first.fields] == [
        ("x", 0, first.fields[0].FLOAT32, 1), ("y", 4, 7, 1), ("z", 8, 7, 1)
    ]  # fmt: skip
    assert (first.height, first.width, first.point_step, first.row_step) == (1, 100, 12, 1200)
    assert (first.header.frame_id, first.is_bigendian) == ("top_lidar", False)
    (place,) = read(bag, "/tf_static")[0].message.transforms
    assert (place.header.frame_id, place.child_frame_id) == ("torso", "top_lidar")
    assert xyz(place.transform.translation) == [0.0, 0.0, 1.0]
    assert len(read(bag, "/tf_static")) == 1, "said once, since it stays where it is"


def test_depth_in_millimetres_is_the_recorded_file_behind_a_head_of_twelve_bytes(tmp_path: Path) -> None:
    episode = depth_scenes.filmed(tmp_path / "data")
    bag, _ = exported(episode, tmp_path / "out")
    found = read(bag, "/head/depth/image/compressedDepth")
    assert len(found) == PICTURES
    assert {one.message.format for one in found} == {"16UC1; compressedDepth png"}
    assert found[4].message.data.tobytes() == bytes(12) + depth_scenes.measured(Shot(4))
    assert found[4].message.header.frame_id == "head_optical_frame"


def test_depth_of_another_step_is_metres_for_ros_has_no_word_for_steps(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    key = keys.camera_depth("head")
    builder.contracts[key] = Contract(key=key, family="x", role="sensor", codec="png", step_m=0.00025)
    steps = depth_scenes.steps(1)
    builder.write({key: depth.encoded(steps)}, at_s=0.1, writer="head")
    builder.write({key: b"none"}, at_s=0.2, writer="head")
    bag, made = exported(builder.finish(), tmp_path / "out")
    (found,) = read(bag, "/head/depth/image")
    message = found.message
    assert (message.encoding, message.height, message.width, message.step) == ("32FC1", *steps.shape, 320)
    metres = message.data.view("<f4").reshape(steps.shape)
    assert np.array_equal(np.isnan(metres), steps == 0)
    assert np.allclose(metres[steps > 0], steps[steps > 0] * 0.00025, rtol=1e-6)
    assert made.facts["unfit"] == {key: 1}


def test_a_camera_that_stated_its_mount_has_a_place_in_the_tree_of_frames(tmp_path: Path) -> None:
    w, x, y, z = TURNED
    mount = {"parent": "torso_link", "position_m": [0.1, 0.2, 0.3], "quat_wxyz": TURNED}
    builder = EpisodeBuilder(tmp_path / "data")
    builder.write({keys.camera_image("head"): filming.jpeg(1)}, at_s=0.1, writer="head")
    stated = {"head": {"role": "sensor", "key": keys.camera_image("head"), "mount": mount}}
    bag, _ = exported(builder.finish({"servers": stated}), tmp_path / "out")
    (place,) = read(bag, "/tf_static")[0].message.transforms
    assert (place.header.frame_id, place.child_frame_id) == ("torso_link", "head_optical_frame")
    assert xyz(place.transform.translation) == [0.1, 0.2, 0.3]
    assert xyzw(place.transform.rotation) == [x, y, z, w]


def test_stated_optics_stand_beside_each_picture_and_wrong_ones_are_told_of(tmp_path: Path) -> None:
    lens = {"distortion": "plumb_bob", "coefficients": [0.1, -0.2, 0.01, 0.02]}
    inner = {"width": 16, "height": 8, "fx": 20.0, "fy": 21.0, "cx": 7.5, "cy": 3.5, **lens}
    for name, stated in (("good", inner), ("bad", inner | {"fx": -1.0})):
        builder = EpisodeBuilder(tmp_path / name)
        for at_s in (0.1, 0.2):
            builder.write({keys.camera_image("head"): filming.jpeg(1)}, at_s=at_s, writer="head")
        facts = {"role": "sensor", "key": keys.camera_image("head"), "intrinsics": stated}
        episode = builder.finish({"servers": {"head": facts}})
        bag, _ = exported(episode, tmp_path / f"{name}-out")
        if name == "bad":
            source = Source(episode_id=episode.name, folder=str(episode))
            (note,) = kind.inspect(source, kind.prepare([source], kind.BagOptions()))
            assert note.startswith(f"{episode.name}: no optics of camera_image_head: intrinsics: fx is -1")
            assert "/head/camera_info" not in connections(bag)
            continue
        found, shown = read(bag, "/head/camera_info"), read(bag, "/head/image/compressed")
        assert [one.stamp_ns for one in found] == [one.stamp_ns for one in shown]
        info = found[0].message
        assert (info.height, info.width, info.distortion_model) == (8, 16, "plumb_bob")
        assert (info.d.tolist(), info.header.frame_id) == ([*lens["coefficients"], 0.0], "head_optical_frame")
        assert info.k.tolist() == [20.0, 0.0, 7.5, 0.0, 21.0, 3.5, 0.0, 0.0, 1.0]
        assert info.p.reshape(3, 4)[:, :3].ravel().tolist() == info.k.tolist()
        assert info.r.tolist() == np.eye(3).ravel().tolist()


def test_a_robot_that_nothing_here_knows_is_exported_by_what_it_stated(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.contracts |= {one.key: one for one in strider.DESCRIPTION.contracts()}
    asked = np.array([0.25, -0.5])
    for number in range(5):
        builder.write({keys.robot_state(strider.NAME): strider.state(asked + 0.1, dq=(1.0, 2.0))}, at_s=number / 50)
        builder.write(strider.step(number, asked), at_s=number / 50 + 0.01)
        builder.write({strider.FEET: b"[12.5, 13.5]"}, at_s=number / 50 + 0.01)
    bag, _ = exported(builder.finish({"servers": {"walker": strider.facts()}}), tmp_path / "out")
    states, commands = read(bag, "/joint_states"), read(bag, "/joint_commands")
    assert len(states) == len(commands) == 5
    assert tuple(states[0].message.name) == strider.KNEES
    assert states[0].message.position.tolist() == (asked + 0.1).tolist()
    assert states[0].message.velocity.tolist() == [1.0, 2.0]
    assert commands[0].message.position.tolist() == asked.tolist()
    feet = read(bag, f"/{strider.FEET}")[0].message
    assert ([one.label for one in feet.layout.dim[2:]], feet.data.tolist()) == (
        ["left_force", "right_force"], [12.5, 13.5]
    )  # fmt: skip


def test_a_key_that_is_not_there_or_has_no_topic_is_refused_in_a_line_when_it_is_asked_for(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.foreign("strange", b"\xff\x00", at_s=0.1)
    builder.write({GATE: json.dumps({"state": "idle"}).encode()}, at_s=0.1)
    episode = builder.finish()
    _, made = exported(episode, tmp_path / "all")
    assert made.facts["left_out"] == {"strange": "nothing describes it: it has no contract"}
    with pytest.raises(EpisodeError, match=r"no key 'strang' in it \(did you mean 'strange'\?\)"):
        exported(episode, tmp_path / "a", "strang")
    with pytest.raises(EpisodeError, match="key 'strange': nothing describes it: it has no contract; leave it out"):
        exported(episode, tmp_path / "b", "strange")
    only, _ = exported(episode, tmp_path / "c", GATE)
    assert set(connections(only)) == {f"/{GATE}"}


def test_the_same_episode_gives_the_same_bytes(walk_bag: tuple[Path, Path], tmp_path: Path) -> None:
    episode, bag = walk_bag
    again, _ = exported(episode, tmp_path / "again")
    files = sorted(path.relative_to(bag) for path in bag.rglob("*"))
    assert [str(file) for file in files] == [f"{episode.name}_0.mcap", "metadata.yaml"]
    assert all((bag / file).read_bytes() == (again / file).read_bytes() for file in files)
