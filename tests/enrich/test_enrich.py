from __future__ import annotations

import json
import os
import time
import tracemalloc
from io import BytesIO
from pathlib import Path

import msgspec
import pytest
from PIL import Image

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.contracts import contract
from station.contract import Element
from station.enrich import source
from station.enrich.enrich import Enriched, enrich
from station.episode.reading.frames import frames
from station.episode.reading.reader import open_episode
from station.errors import EpisodeError
from tests.enrich.read_back import comments, decoded, topics
from tests.enrich.recordings import FALL_S, POSE, filmed, jpeg, walked
from tests.episode import depth_scenes
from tests.episode.scenes import PICTURES, Shot
from tests.episode.synthetic import ROBOT, WALL_START_NS, EpisodeBuilder, walk

HEAD = keys.camera_image("head")
STATE, GATE = keys.robot_state(ROBOT), keys.command_gate(ROBOT)


def enriched(folder: Path, **options: bool) -> Enriched:
    return enrich(open_episode(folder), **options)


@pytest.fixture(scope="module")
def walk_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = walked(tmp_path_factory.mktemp("data"))
    enriched(folder)
    return folder


def test_every_vector_with_names_has_a_typed_topic_with_the_recorded_numbers_times_and_counts(
    walk_folder: Path,
) -> None:
    reader = open_episode(walk_folder)
    typed = topics(walk_folder / source.ENRICHED)
    named = {s.channel.topic: s.channel.contract for s in reader.streams() if s.channel.contract}
    vectors = {topic: c for topic, c in named.items() if c.elements}
    assert len(vectors) >= 9
    for topic, described in vectors.items():
        found = decoded(walk_folder / source.ENRICHED, f"{topic}/typed")
        recorded = [m for m in reader.messages([topic]) if not m.channel.is_deletion]
        assert typed[f"{topic}/typed"] == found[0].schema.name
        assert [field.name for field in found[0].message.DESCRIPTOR.fields] == list(described.names)
        values = [[getattr(one.message, name) for name in described.names] for one in found]
        assert values == reader.vectors(topic).values.tolist()
        assert [one[1:4] for one in found] == [(m.log_ns, m.publish_ns, m.sequence) for m in recorded]
        assert found[0].channel.metadata["source"] == recorded[0].channel.source


def test_the_unit_of_each_element_stands_beside_its_field(walk_folder: Path) -> None:
    schema = decoded(walk_folder / source.ENRICHED, f"{STATE}/typed")[0].schema
    described = contract(STATE)
    assert described is not None
    assert comments(schema) == {element.name: element.unit for element in described.elements if element.unit}


def test_scalars_of_json_objects_are_fields_and_what_is_null_is_absent(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    objects = [
        {"state": "waiting", "age_s": None, "clamped": 0, "refused": {"late": 1}, "list": [1]},
        {"state": "tracking", "age_s": 0.25, "clamped": 3, "refused": {"late": 2}, "list": [1]},
        {"state": "tracking", "age_s": 1, "clamped": 3, "odd": "text"},
        {"state": "holding", "age_s": 2.5, "clamped": 3, "odd": 7, "a b": 1},
    ]
    for number, value in enumerate(objects):
        builder.write({GATE: json.dumps(value).encode()}, at_s=0.1 * number)
    builder.write({GATE: b"[1]"}, at_s=1.0)
    builder.write({GATE: b"not json"}, at_s=1.1)
    folder = builder.finish()
    done = enriched(folder)
    found = [one.message for one in decoded(folder / source.ENRICHED, f"{GATE}/typed")]
    assert [field.name for field in found[0].DESCRIPTOR.fields] == ["state", "age_s", "clamped", "refused_late"]
    assert [one.state for one in found] == ["waiting", "tracking", "tracking", "holding"]
    assert [one.age_s if one.HasField("age_s") else None for one in found] == [None, 0.25, 1.0, 2.5]
    assert [one.refused_late if one.HasField("refused_late") else None for one in found] == [1, 2, None, None]
    assert done.unfit == {GATE: 2}


def test_an_event_is_a_line_of_a_log(walk_folder: Path) -> None:
    (found,) = decoded(walk_folder / source.ENRICHED, f"{keys.EVENT}/log")
    assert found.schema.name == "foxglove.Log"
    assert (found.message.level, found.message.name, found.message.message) == (4, "g1", "fall lean_rad=1.25")
    assert found.message.timestamp.ToNanoseconds() == found.publish_ns == WALL_START_NS + round(FALL_S * 1e9)


def test_poses_of_an_operator_stand_in_his_frame_with_the_quaternion_in_the_right_order(walk_folder: Path) -> None:
    (head,) = decoded(walk_folder / source.ENRICHED, f"{keys.operator_head('pico')}/pose")
    (hand,) = decoded(walk_folder / source.ENRICHED, f"{keys.operator_hand_left('pico')}/poses")
    assert (head.schema.name, hand.schema.name) == ("foxglove.PoseInFrame", "foxglove.PosesInFrame")
    assert head.message.frame_id == hand.message.frame_id == "operator"
    assert len(hand.message.poses) == 26
    for pose in (head.message.pose, hand.message.poses[25]):
        position, turn = pose.position, pose.orientation
        assert [position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z] == POSE


def test_the_root_of_a_simulated_robot_is_a_transform_from_the_world(walk_folder: Path) -> None:
    found = decoded(walk_folder / source.ENRICHED, f"{keys.sim_qpos(ROBOT)}/tf")
    recorded = open_episode(walk_folder).vectors(keys.sim_qpos(ROBOT)).values
    assert [one.message.translation.x for one in found] == recorded[:, 0].tolist()
    last = found[-1].message
    assert (last.parent_frame_id, last.child_frame_id) == ("world", keys.sim_qpos(ROBOT))
    assert (last.rotation.w, last.rotation.x) == (1.0, 0.0)


def test_depth_keeps_its_bytes_and_stands_in_the_frame_of_its_camera(tmp_path: Path) -> None:
    folder = depth_scenes.filmed(tmp_path)
    enriched(folder)
    found = decoded(folder / source.ENRICHED, f"{depth_scenes.DEPTH}/image")
    assert {(one.schema.name, one.message.format, one.message.frame_id) for one in found} == {
        ("foxglove.CompressedImage", "png", "head")
    }
    assert [one.message.data for one in found] == [depth_scenes.measured(Shot(number)) for number in range(PICTURES)]
    left_out = enriched(folder, is_forced=True, pictures=False).left_out
    assert depth_scenes.DEPTH in left_out, "without pictures depth is left out too"


def test_a_picture_keeps_its_bytes_and_tells_when_it_was_taken(tmp_path: Path) -> None:
    now = time.monotonic_ns()
    pictures = [jpeg(10), jpeg(200), jpeg(90)]
    folder = filmed(tmp_path / "film", pictures, [now - 40_000_000, now - 20_000_000, None])
    enriched(folder)
    found = decoded(folder / source.ENRICHED, f"{keys.camera_image('head')}/image")
    assert [one.message.data for one in found] == pictures
    assert {(one.schema.name, one.message.format, one.message.frame_id) for one in found} == {
        ("foxglove.CompressedImage", "jpeg", "head")
    }
    taken = [frame.captured_ns for frame in frames(open_episode(folder), keys.camera_image("head"))]
    assert [one.message.timestamp.ToNanoseconds() for one in found] == taken
    assert taken[0] < taken[1] < found[0].publish_ns <= found[0].log_ns
    assert Image.open(BytesIO(found[1].message.data)).getpixel((0, 0)) == (200, 200, 200)


def test_without_pictures_their_file_is_not_even_read_and_with_them_it_is_made_anew(tmp_path: Path) -> None:
    folder = filmed(tmp_path / "film", [jpeg(10), jpeg(200)], [None, None])
    camera, path = keys.camera_image("head"), folder / source.ENRICHED
    done = enriched(folder, pictures=False)
    assert (done.state, [*done.left_out]) == ("written", [camera])
    assert not [topic for topic in topics(path) if topic.startswith(camera)]
    assert "cameras.mcap" not in path.read_bytes().decode("latin-1")
    assert enriched(folder, pictures=False).state == "current"
    assert enriched(folder).state == "written"
    assert f"{camera}/image" in topics(path)
    assert enriched(folder, pictures=False).state == "written"


INTRINSICS = {"width": 16, "height": 8, "fx": 20.0, "fy": 21.0, "cx": 7.5, "cy": 3.0}
MOUNT = {"parent": "world", "position_m": [0.1, 0.2, 1.5], "quat_wxyz": [0.5, -0.5, 0.5, -0.5]}


@pytest.mark.parametrize("pictures", [True, False])
def test_optics_of_a_camera_are_written_once_at_the_start(tmp_path: Path, pictures: bool) -> None:
    lens = {"distortion": "plumb_bob", "coefficients": [0.1, -0.2, 0.01, 0.02]}
    facts = {"intrinsics": INTRINSICS | lens, "mount": MOUNT}
    folder = filmed(tmp_path / "filmed", [jpeg(10)], [None], facts)
    made = enriched(folder, pictures=pictures)
    path = folder / "enriched.mcap"
    (calibration,) = decoded(path, f"{HEAD}/calibration")
    found, reader = calibration.message, open_episode(folder)
    assert (calibration.log_ns, calibration.schema.name) == (reader.start_ns, "foxglove.CameraCalibration")
    assert found.timestamp.seconds * 10**9 + found.timestamp.nanos == reader.start_ns
    assert (found.frame_id, found.width, found.height) == ("head", 16, 8), "the frame that its pictures name"
    assert (found.distortion_model, list(found.D)) == ("plumb_bob", [0.1, -0.2, 0.01, 0.02, 0.0])
    assert list(found.K) == [20.0, 0.0, 7.5, 0.0, 21.0, 3.0, 0.0, 0.0, 1.0]
    assert list(found.R) == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert list(found.P) == [20.0, 0.0, 7.5, 0.0, 0.0, 21.0, 3.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    (transform,) = decoded(path, f"{HEAD}/tf")
    found = transform.message
    assert (found.parent_frame_id, found.child_frame_id) == ("world", "head")
    assert [found.translation.x, found.translation.y, found.translation.z] == MOUNT["position_m"]
    assert [getattr(found.rotation, axis) for axis in "wxyz"] == MOUNT["quat_wxyz"]
    assert made.messages == 2 + pictures


def test_optics_that_cannot_be_or_lead_nowhere_are_told(tmp_path: Path) -> None:
    facts = {"intrinsics": INTRINSICS, "mount": MOUNT | {"parent": "torso_link"}}
    made = enriched(filmed(tmp_path / "torso", [jpeg(10)], [None], facts))
    told = "it is fixed to torso_link, a frame that the signals do not give"
    assert made.left_out == {f"{HEAD}/tf": told}
    made = enriched(filmed(tmp_path / "wrong", [jpeg(10)], [None], {"intrinsics": INTRINSICS | {"fx": "wide"}}))
    assert list(made.left_out) == [f"{HEAD}/calibration"]
    assert "fx" in made.left_out[f"{HEAD}/calibration"]


def test_what_has_no_names_is_left_out_and_told_of(walk_folder: Path) -> None:
    done = enriched(walk_folder, is_forced=True)
    assert set(done.left_out) == {"strange", keys.policy_obs(ROBOT), keys.policy_action(ROBOT), "operator_joints_gello"}
    assert "no contract" in done.left_out["strange"]
    assert "names no elements" in done.left_out[keys.policy_obs(ROBOT)]
    typed = topics(walk_folder / source.ENRICHED)
    assert not [topic for topic in typed if topic.startswith(tuple(done.left_out))]
    assert done.topics == len(typed)


def test_values_that_do_not_fit_their_contract_are_counted_and_left_out(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number, value in enumerate([codec.f64([0.0] * 65), codec.f64([0.0] * 64), b"1234567"]):
        builder.write({STATE: value}, at_s=0.1 * number)
    builder.write({twist_keys.action_body(): b"[1, NaN]", keys.EVENT: b'{"name": 3}'}, at_s=0.5)
    done = enriched(builder.finish())
    assert done.unfit == {STATE: 2, twist_keys.action_body(): 1, keys.EVENT: 1}
    assert done.messages == 1


def test_the_recording_is_never_touched_and_nothing_else_is_left_in_its_folder(tmp_path: Path) -> None:
    folder = walked(tmp_path)
    signals = folder / "signals.mcap"
    before = signals.read_bytes(), signals.stat().st_mtime_ns, sorted(path.name for path in folder.iterdir())
    enriched(folder)
    files = sorted(path.name for path in folder.iterdir())
    assert (signals.read_bytes(), signals.stat().st_mtime_ns) == before[:2]
    assert files == sorted([*before[2], "enriched.mcap"])
    assert open_episode(folder).path == signals


def test_a_file_that_is_current_is_left_alone_and_one_of_another_recording_or_version_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, other = walked(tmp_path / "one", seconds=0.2), walked(tmp_path / "two", seconds=0.4)
    path = folder / source.ENRICHED
    assert enriched(folder).state == "written"
    inode = path.stat().st_ino
    os.utime(folder / "signals.mcap")  # a copy of the same bytes is no other recording
    assert enriched(folder).state == "current"
    assert path.stat().st_ino == inode
    assert enriched(folder, is_forced=True).state == "written"
    os.replace(other / "signals.mcap", folder / "signals.mcap")
    assert enriched(folder).state == "written"
    assert len(decoded(path, f"{STATE}/typed")) == 20
    path.write_bytes(path.read_bytes()[:10])
    assert enriched(folder).state == "written"
    monkeypatch.setattr(source, "VERSION", source.VERSION + 1)
    assert enriched(folder).state == "written"


def test_the_file_says_what_it_was_made_of(walk_folder: Path) -> None:
    facts = source.facts("walk", source.origins(source.identities(open_episode(walk_folder))))
    (origin,) = msgspec.json.decode(facts["made_of"], type=list[source.Origin])
    assert (origin.file, origin.bytes) == ("signals.mcap", (walk_folder / "signals.mcap").stat().st_size)
    assert len(origin.sha256) == 64


def test_an_episode_that_changes_while_it_is_read_gives_no_file(tmp_path: Path) -> None:
    folder = walked(tmp_path)
    with pytest.raises(EpisodeError, match="changed while it was read"):
        enrich(open_episode(folder), progress=lambda _done, _of: os.utime(folder / "signals.mcap", ns=(1, 1)))
    assert not list(folder.glob("*enriched*"))
    assert not list(folder.glob(".*"))


def test_an_episode_that_was_never_finished_is_refused_with_what_to_do(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.2)
    folder = builder.finish(torn=True)
    with pytest.raises(EpisodeError, match=f"never finished.*station episodes repair {folder.name}"):
        enriched(folder)
    assert not list(folder.glob("*enriched*"))


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    folder = walked(tmp_path)
    (folder / ".enriched.mcap.part").mkdir()
    with pytest.raises(EpisodeError, match=r"enriched\.mcap: cannot be written: Is a directory"):
        enriched(folder)


@pytest.mark.parametrize(
    ("names", "why"),
    [(("a b",), "'a b'"), (("x", "x"), "no message type"), (tuple(f"e{n}" for n in range(2001)), "2001 elements")],
    ids=["no name of a field", "twice", "too many"],
)
def test_a_contract_whose_names_can_be_no_fields_costs_its_own_key_alone(
    tmp_path: Path, names: tuple[str, ...], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    described = contract(STATE)
    assert described is not None
    odd = msgspec.structs.replace(described, elements=tuple(Element(name, "") for name in names))
    with monkeypatch.context() as patch:
        patch.setattr("tests.episode.synthetic.contracts.contract", lambda key: odd if key == STATE else contract(key))
        folder = walked(tmp_path, seconds=0.1)
    done = enriched(folder)
    assert why in done.left_out[STATE]
    assert f"{keys.command_used(ROBOT)}/typed" in topics(folder / source.ENRICHED)


def test_keys_whose_message_types_would_be_called_the_same_get_types_of_their_own(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for device in ("a b", "a_b"):
        builder.write({keys.operator_head(device): codec.f64(POSE)}, at_s=0.1)
    folder = builder.finish()
    enriched(folder)
    named = topics(folder / source.ENRICHED)
    assert named["operator_head_a b/typed"] != named["operator_head_a_b/typed"]
    for device in ("a b", "a_b"):
        assert decoded(folder / source.ENRICHED, f"operator_head_{device}/typed")[0].message.z == POSE[2]


def test_two_writers_of_a_key_stay_apart_on_one_topic(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number in range(4):
        builder.write(
            {STATE: codec.f64([float(number)] * 65)}, at_s=0.1 * number, writer="g1" if number < 2 else "other"
        )
    folder = builder.finish()
    assert enriched(folder).topics == 1
    found = decoded(folder / source.ENRICHED, f"{STATE}/typed")
    assert [(one.channel.metadata["writer"], one.sequence) for one in found] == [
        ("g1", 1), ("g1", 2), ("other", 1), ("other", 2)
    ]  # fmt: skip
    assert len({one.schema.id for one in found}) == 1


def test_a_longer_episode_takes_no_more_memory(tmp_path: Path) -> None:
    def peak(seconds: float, number: int) -> int:
        folder = walked(tmp_path, seconds=seconds, number=number)
        reader = open_episode(folder)
        tracemalloc.start()
        try:
            enrich(reader)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(0.5, 1)  # what is made once
    assert peak(20.0, 2) < 1.2 * peak(10.0, 3)  # ten seconds fill a chunk
