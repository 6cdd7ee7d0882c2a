from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from adapters.exports.ros2.topics import Routes
from station.bus import codec, keys
from station.bus.robot_streams import driven_by_controller
from station.contract import Contract, Element, elements
from station.description import Joint, RobotDescription
from station.episode.reading.reader import open_episode
from tests.adapters.exports.ros2.read_back import connections, exported, read, xyz
from tests.episode.synthetic import EpisodeBuilder

ARMS = tuple(
    RobotDescription(
        name=name, model="arm", joints=(Joint("base"), Joint("tip")), streams=driven_by_controller()
    )
    for name in ("left_arm", "right_arm")
)  # fmt: skip
STATE = [0.1, 0.2, 1.1, 1.2, 10.5, 11.5]


@pytest.fixture
def arms(tmp_path: Path) -> Path:
    """An episode of two arms that say what they are."""
    builder = EpisodeBuilder(tmp_path / "data")
    for arm in ARMS:
        builder.contracts |= {one.key: one for one in arm.contracts()}
    for number, arm in enumerate(ARMS):
        values = [number + value for value in STATE]
        builder.write(
            {
                keys.state_joints(arm.name): codec.f64(values),
                keys.state_tcp(arm.name): codec.f64([0.5, 0.0, 0.25, 1.0, 0.0, 0.0, 0.0]),
                keys.action_joints(arm.name): codec.json_vector([0.5, 0.5]),
                keys.target(arm.name): codec.f64([0.25, 0.25]),
            },
            at_s=0.1, writer=arm.name,
        )  # fmt: skip
    servers = {arm.name: {"description": msgspec.to_builtins(arm)} for arm in ARMS}
    return builder.finish({"servers": servers})


def test_where_there_are_several_robots_each_topic_and_frame_bears_the_name_of_its_own(
    arms: Path, tmp_path: Path
) -> None:
    bag, _ = exported(arms, tmp_path / "out")
    for number, arm in enumerate(ARMS):
        (state,), (command,) = (read(bag, f"/{arm.name}/{what}") for what in ("joint_states", "joint_commands"))
        assert state.message.position.tolist() == [number + value for value in STATE[:2]]
        assert state.message.velocity.tolist() == [number + value for value in STATE[2:4]]
        assert state.message.effort.tolist() == [number + value for value in STATE[4:]]
        assert command.message.position.tolist() == [0.25, 0.25], "as sent, not as asked"
        (asked,) = read(bag, f"/{keys.action_joints(arm.name)}/joint_states")
        assert asked.message.position.tolist() == [0.5, 0.5]
        (tool,) = read(bag, f"/{keys.state_tcp(arm.name)}/pose")
        assert (tool.message.header.frame_id, xyz(tool.message.pose.position)) == (
            f"{arm.name}/base_link", [0.5, 0.0, 0.25]
        )  # fmt: skip
    assert "/joint_states" not in connections(bag)


def test_names_of_topics_are_those_that_ros_takes_and_no_two_keys_share_one(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    strange = ["a:b", "a/b", "a:b:", "9 lives__x", "ä", "joint_states", "state.9-b"]
    for key in strange:
        builder.foreign(key, b"{}", at_s=0.1)
    routes = Routes(open_episode(builder.finish())).routes
    names = {key: route.topics[0].name for key, route in routes.items()}
    assert names == {
        "a/b": "/a/b", "a:b": "/a/b_2", "a:b:": "/a/b_3", "9 lives__x": "/n9_lives_x", "ä": "/key",
        "joint_states": "/joint_states", "state.9-b": "/state_9_b",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("unit", "topic"), [("rad/s", "/state_other/imu"), ("deg/s", "/state_other")]
)  # fmt: skip
def test_what_is_in_another_unit_than_that_of_ros_stays_an_array(tmp_path: Path, unit: str, topic: str) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    key = "state_other"
    builder.contracts[key] = Contract(
        key=key, family="x", role="state", codec="f64", elements=elements((("gyro_x", "gyro_y", "gyro_z"), unit))
    )
    builder.write({key: codec.f64([1.0, 2.0, 3.0])}, at_s=0.1)
    routes = Routes(open_episode(builder.finish())).routes
    assert [one.name for one in routes[key].topics] == [topic]


def test_a_whole_number_is_one_and_text_is_text(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    for key, form in (("state_count", "integer"), ("state_word", "text")):
        builder.contracts[key] = Contract(key=key, family="x", role="state", codec=form)
    builder.write({"state_count": str(2**53 + 1).encode(), "state_word": "größer".encode()}, at_s=0.1)
    builder.write({"state_count": b"no", "state_word": b"\xff"}, at_s=0.2)
    bag, made = exported(builder.finish(), tmp_path / "out")
    assert [one.message.data for one in read(bag, "/state_count")] == [2**53 + 1]
    assert [one.message.data for one in read(bag, "/state_word")] == ["größer"]
    assert made.facts["unfit"] == {"state_count": 1, "state_word": 1}


def test_vectors_that_nothing_names_may_change_their_length_and_named_ones_may_not(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.contracts["policy_free"] = Contract(key="policy_free", family="x", role="policy", codec="f32")
    named = Contract(key="policy_named", family="x", role="policy", codec="json-vector", elements=(Element("a", "m"),))
    builder.contracts["policy_named"] = named
    for count in (1, 3):
        vector = [0.5] * count
        builder.write({"policy_free": codec.f32(vector), "policy_named": codec.json_vector(vector)}, at_s=count / 10)
    bag, made = exported(builder.finish(), tmp_path / "out")
    assert [one.message.data.tolist() for one in read(bag, "/policy_free")] == [[0.5], [0.5] * 3]
    assert [one.message.data.tolist() for one in read(bag, "/policy_named")] == [[0.5]]
    assert made.facts["unfit"] == {"policy_named": 1}


def test_what_an_operator_marked_is_a_diagnostic_of_its_own(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.foreign("a", b"{}", at_s=0.1)
    episode = builder.finish({"marks": [{"at_s": 0.25, "label": "grasp"}]})
    bag, _ = exported(episode, tmp_path / "out")
    (mark,) = read(bag, "/diagnostics")
    (status,) = mark.message.status
    assert (status.name, status.level, status.hardware_id) == ("operator: grasp", status.OK, "operator")
    assert mark.stamp_ns == mark.log_ns == open_episode(episode).start_ns + 250_000_000


@pytest.mark.parametrize(
    "event",
    [b"no", b"[]", b'{"name": "a"}', b'{"name": "a", "severity": "loud", "source": "b"}',
     b'{"name": "a", "severity": ["info"], "source": "b"}',
     b'{"name": "a", "severity": "info", "source": "b", "detail": 1}'],
)  # fmt: skip
def test_what_anybody_wrote_in_the_place_of_an_event_is_counted_and_left_out(tmp_path: Path, event: bytes) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.event("fall", at_s=0.1, severity="warning")
    builder.write({keys.EVENT: event}, at_s=0.2)
    bag, made = exported(builder.finish(), tmp_path / "out")
    assert [one.message.status[0].level for one in read(bag, "/diagnostics")] == [1]
    assert made.facts["unfit"] == {keys.EVENT: 1}
