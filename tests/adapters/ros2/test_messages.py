"""Messages both ways, against rosbags, which made none of ours: as the table says, or refused with a word."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from adapters.policies.pilla_go2 import _SDK, PillaGo2Policy
from adapters.ros2 import heard, table, told
from adapters.ros2.table import TYPES, Joints, PublishRow, SubscribeRow
from station import registry
from station.bus import codec, contracts
from station.errors import ConfigError
from station.protocols import CommandFormat

STORE: Any = get_typestore(Stores.ROS2_HUMBLE)
PILLA = table.read("builtin:ros2/pilla-policy.yaml")
STATE: Any = contracts.contract("robot_state_go2")
NS = 1_700_000_000_123_456_789
rng = np.random.default_rng(3)


def made(kind: str, *values: Any) -> bytes:
    name = TYPES.get(kind, kind)
    return bytes(STORE.serialize_cdr(STORE.types[name](*values), name))


def part(name: str, *values: Any) -> Any:
    return STORE.types[name](*values)


def header(ns: int = 0, frame: str = "") -> Any:
    return part("std_msgs/msg/Header", part("builtin_interfaces/msg/Time", *divmod(ns, 10**9)), frame)


def vector(*xyz: float) -> Any:
    return part("geometry_msgs/msg/Vector3", *map(float, xyz))


def joint_state(names: list[str], positions: list[float], ns: int = 0, velocities: tuple[float, ...] = ()) -> bytes:
    numbers = (np.array(each, np.float64) for each in (positions, velocities, ()))
    return made("joint-state", header(ns, "somewhere"), names, *numbers)


def command(name: str, robot: str = "") -> CommandFormat:
    found = registry.find("command", name)
    return found.for_robot(robot) if robot else found


def read(kind: str, name: str, data: bytes, robot: str = "", **row: Any) -> heard.Heard:
    made_row = SubscribeRow(topic="/x", kind=kind, command=name, robot=robot, **row)
    return heard.reader(made_row, command(name, robot))(data)


def tell(kind: str, values: np.ndarray, key: str = "robot_state_go2", **row: Any) -> Any:
    contract: Any = contracts.contract(key)
    data = codec.json_vector(values) if contract.codec == "json-vector" else values.astype(
        "<f4" if contract.codec == "f32" else "<f8"
    ).tobytes()  # fmt: skip
    message = told.teller(PublishRow(topic="/x", kind=kind, key=key, **row), contract)(data, NS)
    assert message is not None
    return STORE.deserialize_cdr(message, TYPES[kind])


# -- From ROS --------------------------------------------------------------------------------------------------------
def test_a_twist_is_a_velocity_and_one_that_leaves_the_ground_is_refused() -> None:
    found = read("twist", "velocity", made("twist", vector(0.5, -0.1, 0), vector(0, 0, 0.3)), robot="go2")
    assert found == heard.Heard([0.5, -0.1, 0.3], 0)
    stamped = made(
        "twist-stamped", header(NS, "base"), part("geometry_msgs/msg/Twist", vector(1, 0, 0), vector(0, 0, 0))
    )
    assert read("twist-stamped", "velocity", stamped, robot="go2") == heard.Heard([1.0, 0.0, 0.0], NS)
    for kind, linear, angular in (
        ("not-planar", (0, 0, 1), (0, 0, 0)), ("not-planar", (0, 0, 0), (0.1, 0, 0)),
        ("not-finite", (math.nan, 0, 0), (0, 0, 0)), ("not-finite", (0, 0, 0), (0, math.inf, 0)),
    ):  # fmt: skip
        with pytest.raises(heard.BadMessage) as caught:
            read("twist", "velocity", made("twist", vector(*linear), vector(*angular)), robot="go2")
        assert caught.value.kind == kind


def test_joints_are_found_by_name_in_any_order() -> None:
    names = [element.name.removesuffix("_pos") for element in command("go2-joints").elements]
    values = rng.uniform(-0.5, 0.5, 12).tolist()
    order = rng.permutation(12)
    data = joint_state([names[one] for one in order], [values[one] for one in order], NS)
    assert read("joint-state", "go2-joints", data) == heard.Heard(values, NS)


@pytest.mark.parametrize("kind", ["wrong-names", "wrong-length", "twice"])
def test_other_joints_than_those_of_the_command_are_refused(kind: str) -> None:
    names = [element.name.removesuffix("_pos") for element in command("go2-joints").elements]
    given = {"wrong-names": ["tail", *names[1:]], "wrong-length": names, "twice": [names[1], *names[1:]]}[kind]
    data = joint_state(given, [0.0] * (11 if kind == "wrong-length" else 12))
    with pytest.raises(heard.BadMessage) as caught:
        read("joint-state", "go2-joints", data)
    assert caught.value.kind == ("wrong-names" if kind == "twice" else kind)


def test_numbers_come_as_an_array_with_or_without_a_layout() -> None:
    dimension = part("std_msgs/msg/MultiArrayDimension", "joints", 3, 3)
    for dimensions in ([], [dimension], [dimension, dimension]):
        layout = part("std_msgs/msg/MultiArrayLayout", dimensions, 0)
        data = made("float32-array", layout, np.array([0.5, 0.25, -0.125], np.float32))
        assert read("float32-array", "velocity", data, robot="go2").numbers == [0.5, 0.25, -0.125]
    empty = made("float32-array", part("std_msgs/msg/MultiArrayLayout", [], 0), np.array([], np.float32))
    with pytest.raises(heard.BadMessage, match="0 numbers, expected 3"):
        read("float32-array", "velocity", empty, robot="go2")


def test_every_truncation_of_a_message_is_refused() -> None:
    whole = joint_state([f"joint_{number}" for number in range(1, 13)], [0.1] * 12, NS)
    row = PILLA.subscribe[0]
    take = heard.reader(row, command(row.command))
    take(whole)
    for length in range(len(whole) - 8):  # behind the positions stand two empty lists, which nobody reads
        with pytest.raises(heard.BadMessage):
            take(whole[:length])


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"kind": "twist", "command": "go2-joints"}, "a twist holds vx, vy, wz"),
        ({"kind": "joint-state", "command": "velocity", "robot": "go2"}, "holds no positions of joints"),
        ({"kind": "joint-state", "command": "go2-joints", "joints": Joints(names=("FL_hip", "tail"))}, "differ in"),
    ],
    ids=["twist", "velocity", "other-joints"],
)
def test_messages_that_cannot_be_such_a_command_are_an_error_before_anything_runs(
    row: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        heard.reader(SubscribeRow(topic="/x", **row), command(row["command"], row.get("robot", "")))


# -- To ROS ----------------------------------------------------------------------------------------------------------
def a_state() -> np.ndarray:
    state = rng.uniform(-1, 1, len(STATE.elements))
    state[24:28] /= np.linalg.norm(state[24:28])
    return state


def test_a_robots_state_is_a_joint_state_in_its_own_order_and_units() -> None:
    state = a_state()
    found = tell("joint-state", state)
    assert found.name == [name.removesuffix("_pos") for name in STATE.names[:12]]
    np.testing.assert_array_equal(found.position, state[:12])
    np.testing.assert_array_equal(found.velocity, state[12:24])
    assert len(found.effort) == 0
    assert found.header.stamp.sec * 10**9 + found.header.stamp.nanosec == NS


def test_pillas_topics_are_what_its_policy_was_trained_on() -> None:
    state = a_state()
    joints, imu = (row for row in PILLA.publish if row.key == "robot_state_go2")
    found = tell("joint-state", state, joints=joints.joints)
    default = PillaGo2Policy.DEFAULT_Q
    np.testing.assert_allclose(found.position, (state[:12] - default)[_SDK], atol=1e-12)
    np.testing.assert_allclose(found.velocity, 0.05 * state[12:24][_SDK], atol=1e-12)
    upright = state.copy()
    upright[24:28] = [1, 0, 0, 0]
    down = tell("imu", upright, acceleration=imu.acceleration)
    assert (down.linear_acceleration.x, down.linear_acceleration.y, down.linear_acceleration.z) == (0, 0, -1)
    assert [down.angular_velocity.x, down.angular_velocity.y, down.angular_velocity.z] == state[28:31].tolist()
    action = rng.uniform(-3, 3, 12)
    row = PILLA.subscribe[0]
    names = [f"joint_{number}" for number in range(1, 13)]
    came = heard.reader(row, command(row.command))(joint_state(names, action.tolist()))
    np.testing.assert_allclose(came.numbers, default + 0.25 * action[_SDK], atol=1e-12)
    assert came.stamp_ns == 0, "its node leaves the header empty"


def test_an_imu_without_a_measured_acceleration_says_so() -> None:
    found = tell("imu", a_state())
    assert found.linear_acceleration_covariance[0] == -1
    assert found.orientation_covariance[0] == 0


def test_velocities_arrays_transforms_and_clocks_are_what_ros_reads() -> None:
    twist = tell("twist", np.array([0.5, -0.25, 0.125]), key="action_velocity_go2")
    assert (twist.linear.x, twist.linear.y, twist.angular.z, twist.linear.z) == (0.5, -0.25, 0.125, 0)
    stamped = tell("twist-stamped", np.array([0.5, -0.25, 0.125]), key="action_velocity_go2", frame="base")
    assert (stamped.twist.linear.x, stamped.header.frame_id) == (0.5, "base")
    numbers = rng.uniform(-1, 1, 45).astype(np.float32)
    np.testing.assert_array_equal(tell("float32-array", numbers, key="policy_obs_go2").data, numbers)
    place = np.arange(1.0, 20.0)
    (transform,) = tell("transform", place, key="sim_qpos_go2", frame="base").transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("world", "base")
    turned = transform.transform.rotation
    assert (turned.w, turned.x, turned.y, turned.z) == (4, 5, 6, 7)
    clock = told.teller(PublishRow(topic="/clock", kind="clock", key="robot_state_go2"), None)(b"", NS)
    assert STORE.deserialize_cdr(clock, TYPES["clock"]).clock.nanosec == NS % 10**9


def test_the_last_word_of_a_topic_that_drives_is_a_velocity_of_zero_and_others_have_none() -> None:
    for kind in ("twist", "twist-stamped"):
        word = told.last_word(PublishRow(topic="/cmd_vel", kind=kind, key="x"))
        found = STORE.deserialize_cdr(word, TYPES[kind])
        linear = (found.twist if kind == "twist-stamped" else found).linear
        assert (linear.x, linear.y) == (0, 0)
    assert told.last_word(PublishRow(topic="/imu", kind="imu", key="x")) == b""
    assert told.last_word(PublishRow(topic="/cmd_vel", kind="twist", key="x", zero_after_s=0.0)) == b""


def test_a_value_that_is_not_what_its_key_is_described_to_hold_becomes_no_message() -> None:
    make = told.teller(PublishRow(topic="/x", kind="joint-state", key="robot_state_go2"), STATE)
    assert make(bytes(8 * 31), NS) is not None
    for bad in (b"", bytes(8 * 30), bytes(7), b"[1]"):
        assert make(bad, NS) is None


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"kind": "imu", "key": "action_velocity_go2"}, "needs 'gyro_x'"),
        ({"kind": "compressed-image", "key": "robot_state_go2"}, "holds f64"),
        ({"kind": "joint-state", "key": "command_gate_go2"}, "made of numbers"),
        ({"kind": "twist", "key": "nobody_knows"}, "nothing describes"),
        ({"kind": "joint-state", "key": "robot_state_go2", "joints": Joints(names=("tail",))}, "'tail_pos'"),
    ],
    ids=["imu", "image", "json", "unknown", "joint"],
)
def test_a_key_that_cannot_be_such_messages_says_why(row: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        told.teller(PublishRow(topic="/x", **row), contracts.contract(row["key"]))
