"""Our messages and a real ROS 2's, field for field, over DDS: rclpy on Fast DDS, and our own participant on Cyclone.

All types of the bridge's table but TFMessage, of which there is no wheel. Each has a message that our encoders make, as
the bus has it, and one of awkward values: empty, no numbers, words of several alphabets, odd lengths.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from cyclonedds.idl import IdlStruct, make_idl_struct, types

from adapters.exports.ros2 import messages
from adapters.exports.ros2.ros_types import cdr, header, make
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import LOOPBACK, NetworkOptions
from adapters.ros2 import heard
from adapters.ros2.table import TYPES, PublishRow, SubscribeRow
from adapters.ros2.told import STOPPED, teller
from station import registry
from station.bus import codec, contracts
from station.point_cloud import PointCloud, PointField, SensorPose
from tests.adapters.ros2.test_messages import STORE
from tests.dds_domains import domain
from tests.ros import Peer, peer, ros_python
from tests.waiting import wait_until

NS = 1_700_000_000_123_456_789
WORDS = "Hüfte 左 🦿"
CHANCE = np.random.default_rng(8)
PICTURE = CHANCE.integers(0, 256, 200_001, np.uint8).tobytes()
ODD = (math.nan, -0.0, 5e-324, -math.inf, 1.0000000000000002)


def told(kind: str, key: str, numbers: np.ndarray) -> bytes:
    """Return the message that the bridge makes of a value of the bus."""
    contract: Any = contracts.contract(key)
    value = codec.json_vector(numbers) if contract.codec == "json-vector" else numbers.tobytes()
    found = teller(PublishRow(topic="/x", kind=kind, key=key), contract)(value, NS)
    assert found is not None
    return found


def of_ours() -> dict[str, bytes]:
    """Return a message of each kind, as the station makes it."""
    state, velocity = np.linspace(-1.0, 1.0, 31), np.array([0.5, -0.25, 0.125])
    fields = tuple(PointField(name, 4 * at, "<f4") for at, name in enumerate("xyz"))
    cloud = PointCloud("x", SensorPose(), 17, (*fields, PointField("ring", 16, "u1")), PICTURE[: 17 * 37])
    event = {"source": WORDS, "name": "stopped", "severity": "error", "detail": {"reason": WORDS, "vx": 0.5}}
    return {
        "joint-state": told("joint-state", "robot_state_go2", state), "imu": told("imu", "robot_state_go2", state),
        "twist": told("twist", "action_velocity_go2", velocity),
        "twist-stamped": told("twist-stamped", "action_velocity_go2", velocity),
        "compressed-image": messages.jpeg(NS, WORDS, PICTURE), "point-cloud": messages.cloud(NS, WORDS, cloud),
        "float32-array": told("float32-array", "action_velocity_go2", velocity),
        "diagnostics": messages.diagnostics(NS, event), "clock": told("clock", "robot_state_go2", state),
    }  # fmt: skip


def awkward() -> dict[str, bytes]:
    """Return a message of each kind that is hard to write and to read."""

    def xyz(at: int) -> Any:
        return make("geometry_msgs/msg/Vector3", *np.roll(ODD, at)[:3].tolist())

    def numbers(count: int, kind: Any = np.float64) -> np.ndarray:
        return np.resize(np.array(ODD), count).astype(kind)

    head, nothing, twist = header(0, WORDS), np.array([], np.uint8), make("geometry_msgs/msg/Twist", xyz(0), xyz(2))
    turned = make("geometry_msgs/msg/Quaternion", *ODD[:4])
    field = make("sensor_msgs/msg/PointField", WORDS, 2**32 - 1, 255, 0)
    sizes = [make("std_msgs/msg/MultiArrayDimension", word, 3, 0) for word in ("", "a", WORDS)]
    values = [make("diagnostic_msgs/msg/KeyValue", word, word[:1]) for word in ("", "ab", WORDS)]
    said = [make("diagnostic_msgs/msg/DiagnosticStatus", level, "a", "", WORDS, values[level:]) for level in range(4)]
    made = {
        "joint-state": (head, ["", "a", WORDS], numbers(3), numbers(0), numbers(1)),
        "imu": (head, turned, numbers(9), xyz(1), numbers(9), xyz(3), numbers(9)),
        "twist": (xyz(0), xyz(1)), "twist-stamped": (header(NS, "abc"), twist),
        "compressed-image": (header(NS, ""), WORDS, nothing),
        "point-cloud": (head, 2**32 - 1, 0, [field], True, 3, 7, np.frombuffer(PICTURE[:7], np.uint8), True),
        "float32-array": (make("std_msgs/msg/MultiArrayLayout", sizes, 7), numbers(5, np.float32)),
        "diagnostics": (head, said), "clock": (make("builtin_interfaces/msg/Time", -(2**31), 2**32 - 1),),
    }  # fmt: skip
    return {kind: cdr(make(TYPES[kind], *fields)) for kind, fields in made.items()}


def cases() -> dict[str, tuple[str, bytes]]:
    """Return kind and bytes of each message, by a name that topics may have."""
    found = {"ours": of_ours(), "awkward": awkward()}
    assert all(set(each) == set(TYPES) - {"transform"} for each in found.values())
    named = {f"{of}_{kind}".replace("-", "_"): (kind, data) for of in found for kind, data in found[of].items()}
    return named | {"stopped": ("twist", STOPPED)}


CASES = cases()


def dds_type(name: str) -> type[IdlStruct]:
    """Return what DDS calls a type of ROS, made from its definition."""
    basic = {"string": str, "bool": bool, "byte": types.byte, "float32": types.float32, "float64": types.float64}

    def of(described: Any) -> Any:
        kind, about = described
        if kind.name == "NAME":
            return dds_type(about)
        if kind.name == "BASE":
            return basic.get(about[0]) or getattr(types, about[0])
        inner = of(about[0])
        return types.array[inner, about[1]] if kind.name == "ARRAY" else types.sequence[inner]

    package, _, word = name.split("/")
    fields = {field: of(described) for field, described in STORE.fielddefs[name][1]}
    made: type[IdlStruct] = make_idl_struct(f"{word}_", f"{package}.msg.dds_.{word}_", fields)
    return made


def fields_of(kind: str, data: bytes) -> dict[str, Any]:
    """Return the fields of a message, as rosbags reads it; octets and their arrays are hexadecimal, as in the peer."""

    def plain(described: Any, value: Any) -> Any:
        of, about = described
        if of.name == "NAME":
            return {name: plain(inner, getattr(value, name)) for name, inner in STORE.fielddefs[about][1]}
        if of.name == "BASE":
            return bytes([value]).hex() if about[0] == "byte" else value
        if about[0][1] == ("uint8", 0):
            return value.tobytes().hex()
        return [plain(about[0], one) for one in (value.tolist() if isinstance(value, np.ndarray) else value)]

    named: Any = type(STORE.fielddefs["std_msgs/msg/Header"][1][0][1][0]).NAME
    found: dict[str, Any] = plain((named, TYPES[kind]), STORE.deserialize_cdr(data, TYPES[kind]))
    return found


def said(fields: dict[str, Any]) -> str:
    """Return fields as text, in which every number has its own words, one that is none and -0 too."""
    return json.dumps({name: value for name, value in fields.items() if name != "at_ns"}, sort_keys=True)


@pytest.fixture
def both(processes: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Network, Peer]]:
    """Our participant and a node of ROS, alone on a domain of this computer's loopback."""
    ros_python()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # Ours has no shared memory; Fast DDS meets there what nodes that were killed have left behind.
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    with domain() as number, Network(NetworkOptions(interface=LOOPBACK, domain=number)) as ours, peer(number) as node:
        yield ours, node


def test_rclpy_reads_what_we_write(both: tuple[Network, Peer]) -> None:
    ours, node = both
    waiting = dict(CASES)
    for topic, (kind, _) in waiting.items():
        node.listen(f"/{topic}", TYPES[kind])
    writers = {topic: ours.writer(f"rt/{topic}", raw(dds_type(TYPES[kind]))) for topic, (kind, _) in waiting.items()}

    def are_all_heard() -> bool:
        """Write what was not heard yet: a subscription that is not known yet gets nothing."""
        for topic, (kind, data) in list(waiting.items()):
            writers[topic].write(data)
            for found in node.heard(f"/{topic}"):
                assert said(found) == said(fields_of(kind, data)), topic
                waiting.pop(topic, None)
        return not waiting

    with _telling(waiting):
        wait_until(are_all_heard)


def test_we_read_what_rclpy_writes(both: tuple[Network, Peer]) -> None:
    ours, node = both
    waiting = dict(CASES)
    readers = {
        topic: ours.reader(f"rt/{topic}", dds_type(TYPES[kind]), 10, is_reliable=True)
        for topic, (kind, _) in waiting.items()
    }
    for topic, (kind, data) in waiting.items():
        node.publish(f"/{topic}", TYPES[kind], 10.0, **fields_of(kind, data))

    def are_all_read() -> bool:
        for topic, (kind, data) in list(waiting.items()):
            for found in readers[topic].take():
                assert said(fields_of(kind, found)) == said(fields_of(kind, data)), topic
                assert _command(topic, kind, found) == _command(topic, kind, data), topic
                waiting.pop(topic, None)
        return not waiting

    with _telling(waiting):
        wait_until(are_all_read)


@pytest.mark.parametrize("topic", CASES)
def test_a_byte_that_is_another_is_seen(topic: str) -> None:
    kind, data = CASES[topic]
    for byte in [at for at in range(4, len(data)) if data[at]][:400]:  # gaps are zeros, and a picture is long
        damaged = data[:byte] + b"\0" + data[byte + 1 :]
        try:
            found = said(fields_of(kind, damaged))
        except Exception:  # noqa: BLE001 - what rosbags says of bytes that are no message is its own
            continue
        assert found != said(fields_of(kind, data)), byte


def _command(topic: str, kind: str, data: bytes) -> heard.Heard | None:
    """Return what the bridge would command by a message of ours, where it takes such."""
    names = {"twist": "velocity", "twist-stamped": "velocity", "float32-array": "velocity", "joint-state": "go2-joints"}
    if kind not in names or not topic.startswith("ours"):
        return None
    row = SubscribeRow(topic="/x", kind=kind, command=names[kind], robot="go2" if names[kind] == "velocity" else "")
    found = registry.find("command", names[kind])
    return heard.reader(row, found.for_robot("go2") if row.robot else found)(data)


@contextlib.contextmanager
def _telling(waiting: dict[str, Any]) -> Iterator[None]:
    """Say of a failure which topics were not heard."""
    try:
        yield
    except AssertionError as error:
        error.add_note(f"not yet heard: {', '.join(waiting)}")
        raise
