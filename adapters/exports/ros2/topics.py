"""Which topics a key of an episode becomes, by what its contract says; docs/ros2-bags.md has the table.

A key may become several topics. One whose topics do not hold all of its numbers has them all in one of arrays as well,
so that nothing recorded is missing from a bag.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from adapters.exports.jointstate import JointStates
from adapters.exports.ros2 import messages
from station import depth
from station.bus import codec, keys
from station.bus.robot_streams import QUAT, ROOT
from station.contract import DEPTH_STEP_M, IMU, OPERATOR_FRAME, POSE, WORLD_FRAME, Codec, Contract, Element, elements
from station.episode.reading import frames, steps
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.vectors import decoder
from station.export.columns import KeyColumns
from station.point_cloud import BadCloud, PointCloud, SensorPose, decoded

TF, TF_STATIC, DIAGNOSTICS = "/tf", "/tf_static", "/diagnostics"
"""Topics that several keys may write to."""
SHARED = (TF, TF_STATIC, DIAGNOSTICS)

BASE, OPTICAL_FRAME, LIDAR = "base_link", "optical_frame", "lidar"
"""Names of frames, as REP-103 and REP-105 have them: of a robot's root, of a camera (z forward), of a lidar."""

_GYRO, _ACC = IMU[:3], IMU[3:]
_QUAT = elements((QUAT, ""))
_PLANAR = elements((("vx", "vy"), "m/s"), (("wz",), "rad/s"))
_NOTHING_DESCRIBES = "nothing describes it: it has no contract"


class Topic(NamedTuple):
    """One topic of a key.

    Attributes:
        name: Full name.
        type: Type of its messages.
        encode: ``(value, stamp_ns) -> bytes``: a message of a value that was read; None where there is none to write.
    """

    name: str
    type: str
    encode: Callable[[Any, int], bytes | None]


class Route(NamedTuple):
    """What becomes of a key.

    Attributes:
        read: Returns the value of a write; None where it does not fit its contract.
        topics: Where it goes.
        contract: What was recorded of the key; None where nothing was.
        is_captured: Whether it has a time of capture, which its messages are stamped with.
    """

    read: Callable[[Message], Any]
    topics: tuple[Topic, ...]
    contract: Contract | None
    is_captured: bool = False


class Static(NamedTuple):
    """A frame that stands still in another: seven numbers as in `messages.pose`."""

    parent: str
    child: str
    values: tuple[float, ...]


class Routes:
    """What becomes of each key of an episode.

    Args:
        reader: The episode.
        wanted: Keys; none for all.

    Attributes:
        routes: By key.
        left_out: Why a key has no topic, by key.
        unfit_optics: What is wrong with the optics that were stated of a key, by key.
        mounts: Of its cameras.
    """

    def __init__(self, reader: EpisodeReader, wanted: Collection[str] = ()) -> None:
        self._reader = reader
        self._names: dict[str, str] = {}
        self._recorded = {key: reader.contract(key) for key in reader.recorded}
        self._cameras = {key: name for name, key in (*frames.depths(reader).items(), *frames.cameras(reader).items())}
        self._optics, self.unfit_optics = frames.optics(reader)
        self._robots = _robots(reader)
        self._joints = {key: made for key, one in self._recorded.items() if (made := _joints_of(key, one)) is not None}
        self._first = self._of_robots()
        self.routes: dict[str, Route] = {}
        self.left_out: dict[str, str] = {}
        for key in sorted(self._recorded):
            if wanted and key not in wanted:
                continue
            found = self._route(key, self._recorded[key])
            if isinstance(found, str):
                self.left_out[key] = found
            else:
                self.routes[key] = found
        self.mounts = self._mounts()

    def _of_robots(self) -> dict[tuple[str, str], str]:
        """Return which key is the first of its kind of a robot: what it measured, what it was sent, and so on."""
        found: dict[tuple[str, str], str] = {}
        for robot in self._robots:
            states = steps.keys_of_joints(self._reader, robot, "state", (keys.robot_state, keys.state_joints))
            sent = steps.keys_of_joints(self._reader, robot, "command", (keys.target,))
            for what, candidates in (("joint_states", states), ("joint_commands", sent)):
                if (key := next((key for key in candidates if key in self._joints), "")) != "":
                    found[robot, what] = key
            of_it = [key for key in self._recorded if self._owner(key) == robot]
            state_first = sorted(of_it, key=lambda key: (key not in states, key))
            for what, role, wanted in (
                ("imu", "state", _GYRO), ("tf", "state", ROOT), ("cmd_vel", "command", _PLANAR)
            ):  # fmt: skip
                holding = (key for key in state_first if {*wanted} <= {*_elements_of(self._recorded[key], role)})
                if (key := next(holding, "")) != "":
                    found[robot, what] = key
        return found

    def _owner(self, key: str) -> str:
        """Return the robot that a key is of; "" for none."""
        fitting = [robot for robot in self._robots if key.endswith(f"_{robot}")]
        return max(fitting, key=len, default="")

    def _name(self, *parts: str, key: str = "") -> str:
        """Return a name for a topic that no other key's topic has."""
        name = first = "/" + "/".join(token for part in parts for token in _tokens(part))
        number = 1
        while self._names.setdefault(name, key) != key:
            number += 1
            name = f"{first}_{number}"
        return name

    def _of_robot(self, robot: str, what: str, key: str) -> str:
        """Return a topic of a robot, which bears its name where there are several."""
        return self._name(*([robot] if len(self._robots) > 1 else []), what, key=key)

    def _base(self, robot: str) -> str:
        """Return the frame of a robot's root."""
        return "/".join([*(_tokens(robot) if len(self._robots) > 1 else []), BASE])

    def _route(self, key: str, contract: Contract | None) -> Route | str:
        if contract is None:
            return self._unknown(key)
        if key == keys.EVENT:
            return self._event(contract)
        by_codec: dict[Codec, Callable[[str, Contract], Route]] = {
            "jpeg": self._picture, "png": self._depth, "point-cloud": self._cloud, "json": self._text,
            "text": self._text, "integer": self._integer, "f64-rows": self._rows,
        }  # fmt: skip
        return by_codec.get(contract.codec, self._vector)(key, contract)

    def _unknown(self, key: str) -> Route | str:
        """Return what becomes of a key that nothing describes: text where it was recorded as JSON."""
        said = {channel.encoding for channel in self._reader.channels() if channel.topic == key}
        return self._text(key, None) if "json" in said else _NOTHING_DESCRIBES

    def _event(self, contract: Contract) -> Route:
        topic = Topic(DIAGNOSTICS, messages.DIAGNOSTICS, lambda event, ns: messages.diagnostics(ns, event))
        return Route(_event_of, (topic,), contract)

    def _integer(self, key: str, contract: Contract) -> Route:
        topic, decode = Topic(self._name(key, key=key), messages.INTEGER, _integer), decoder("integer")
        return Route(lambda message: decode(message.data), (topic,), contract)

    def _text(self, key: str, contract: Contract | None) -> Route:
        topic = Topic(self._name(key, key=key), messages.TEXT, lambda value, _: messages.text(value))
        return Route(_utf8, (topic,), contract)

    def _picture(self, key: str, contract: Contract) -> Route:
        camera = self._cameras[key]
        frame = _frame(camera, OPTICAL_FRAME)
        name = self._name(camera, "image/compressed", key=key)
        topic = Topic(name, messages.COMPRESSED, lambda data, ns: messages.jpeg(ns, frame, data))
        return Route(_data, (topic, *self._info(key, frame, camera)), contract, is_captured=True)

    def _depth(self, key: str, contract: Contract) -> Route:
        camera, step_m = self._cameras[key], frames.step_m(self._reader, key)
        frame = _frame(camera, OPTICAL_FRAME)
        info = self._info(key, frame, camera, "depth")
        if abs(step_m - DEPTH_STEP_M) < 1e-9:
            name = self._name(camera, "depth/image/compressedDepth", key=key)
            topic = Topic(name, messages.COMPRESSED, lambda data, ns: messages.depth_in_millimetres(ns, frame, data))
            return Route(_data, (topic, *info), contract, is_captured=True)
        name = self._name(camera, "depth/image", key=key)
        topic = Topic(name, messages.IMAGE, lambda steps, ns: messages.depth_in_metres(ns, frame, steps, step_m))
        return Route(lambda message: depth.decoded(message.data), (topic, *info), contract, is_captured=True)

    def _info(self, key: str, frame: str, *where: str) -> list[Topic]:
        """Return the topic of a camera's optics, a message beside each picture, where its server stated them."""
        inner = self._optics[key].intrinsics if key in self._optics else None
        if inner is None:
            return []
        name = self._name(*where, "camera_info", key=key)
        return [Topic(name, messages.CAMERA_INFO, lambda _, ns: messages.camera_info(ns, frame, inner))]

    def _cloud(self, key: str, contract: Contract) -> Route:
        lidar = key.removeprefix(keys.lidar_cloud(""))
        frame, placed = _frame(lidar, LIDAR), _Placed()
        points = Topic(
            self._name(lidar, "points", key=key), messages.CLOUD, lambda cloud, ns: messages.cloud(ns, frame, cloud)
        )
        mount = Topic(TF_STATIC, messages.TRANSFORMS, lambda cloud, ns: placed.encode(ns, frame, cloud))
        return Route(_cloud_of, (mount, points), contract, is_captured=True)

    def _rows(self, key: str, contract: Contract) -> Route:
        made, width = messages.NumberArrays(contract.names), len(contract.elements)

        def read(message: Message) -> Any:
            fits = width and len(message.data) % (8 * width) == 0
            return np.frombuffer(message.data, "<f8").reshape(-1, width) if fits else None

        topic = Topic(self._name(key, key=key), messages.NUMBERS, lambda table, _: made.encode(table))
        return Route(read, (topic,), contract)

    def _vector(self, key: str, contract: Contract) -> Route:
        decode, names = decoder(contract.codec), contract.names

        def read(message: Message) -> Any:
            row = decode(message.data)
            fits = row is not None and (not names or len(row) == len(names))
            return (row.tolist() if isinstance(row, np.ndarray) else row) if fits else None

        topics, shown = self._typed(key, contract)
        if not topics or len(shown) < len(names):
            made = messages.NumberArrays(names)
            topics.append(Topic(
                self._name(key, key=key), messages.NUMBERS,
                lambda row, _: made.encode(messages.table(row, len(row))),
            ))  # fmt: skip
        return Route(read, tuple(topics), contract)

    def _typed(self, key: str, contract: Contract) -> tuple[list[Topic], set[int]]:
        """Return the topics of a vector that have a meaning in ROS, and the places of the numbers that they hold."""
        robot = self._owner(key)
        place = {element: index for index, element in enumerate(contract.elements)}
        topics: list[Topic] = []
        shown: set[int] = set()

        def is_first(what: str) -> bool:
            return self._first.get((robot, what)) == key

        def part(wanted: Sequence[Element]) -> list[int]:
            found = [place[element] for element in wanted] if {*wanted} <= place.keys() else []
            shown.update(found)
            return found

        if (joints := self._joints.get(key)) is not None:
            what = next((what for what in ("joint_states", "joint_commands") if is_first(what)), "")
            name = self._of_robot(robot, what, key) if what else self._name(key, "joint_states", key=key)
            topics.append(Topic(name, messages.JOINT_STATE, joints.encode))
            shown.update(joints.places)
        if is_first("tf"):
            root, base = part(ROOT), self._base(robot)
            topics.append(Topic(
                TF, messages.TRANSFORMS,
                lambda row, ns: messages.transform(ns, WORLD_FRAME, base, [row[one] for one in root]),
            ))  # fmt: skip
        if {*_GYRO} <= place.keys() and contract.role in ("state", "sensor"):
            topics.append(self._imu(key, robot, part(_QUAT), part(_GYRO), part(_ACC), is_first=is_first("imu")))
        if is_first("cmd_vel"):
            planar, base = part(_PLANAR), self._base(robot)
            name = self._of_robot(robot, "cmd_vel", key)
            topics.append(Topic(name, messages.TWIST, lambda row, ns: _planar(ns, base, [row[one] for one in planar])))
        if contract.elements == POSE:
            frame = self._base(robot) if robot else OPERATOR_FRAME
            name = self._name(key, "pose", key=key)
            topics.append(Topic(name, messages.POSE, lambda row, ns: messages.pose(ns, frame, row)))
            shown.update(range(len(POSE)))
        return topics, shown

    def _imu(
        self, key: str, robot: str, quat: list[int], gyro: list[int], acc: list[int], *, is_first: bool
    ) -> Topic:  # fmt: skip
        lidar = key.removeprefix(keys.lidar_imu(""))
        if is_first:
            name, frame = self._of_robot(robot, "imu", key), self._base(robot)
        elif lidar != key:
            name, frame = self._name(lidar, "imu", key=key), _frame(lidar, LIDAR)
        else:
            name, frame = self._name(key, "imu", key=key), self._base(robot) if robot else _frame(key, "imu")

        def encode(row: Sequence[float], ns: int) -> bytes:
            turned, turning, pushed = ([row[one] for one in places] for places in (quat, gyro, acc))
            return messages.imu(ns, frame, turned or None, turning, pushed or None)

        return Topic(name, messages.IMU, encode)

    def _mounts(self) -> list[Static]:
        """Return where its cameras are mounted; depth is in the frame of its camera."""
        stated = {
            camera: self._optics[key].mount
            for key, camera in self._cameras.items()
            if key in self._optics and key in self.routes
        }
        return [
            Static(mount.parent, _frame(camera, OPTICAL_FRAME), (*mount.position_m, *mount.quat_wxyz))
            for camera, mount in sorted(stated.items())
            if mount is not None
        ]


class _Placed:
    """Says where a lidar is, once and whenever that is another place."""

    def __init__(self) -> None:
        self._said: tuple[str, SensorPose] | None = None

    def encode(self, stamp_ns: int, frame: str, cloud: PointCloud) -> bytes | None:
        """Return the transform of a cloud's sensor; None where it is said, or its cloud does not say."""
        place = cloud.frame, cloud.pose
        if place == self._said or not cloud.frame or cloud.frame == frame:
            return None
        self._said = place
        return messages.transform(stamp_ns, cloud.frame, frame, [*cloud.pose.position_m, *cloud.pose.quat_wxyz])


def _robots(reader: EpisodeReader) -> list[str]:
    """Return the suffixes of the robots of an episode, of each of which a state or a command is there."""
    topics = reader.recorded.keys()
    families = (keys.policy_timing, keys.target, *steps.STATES)
    known = [*steps.robots_of(reader), *steps.robots(topics, families), reader.manifest.robot.suffix]
    return [one for one in dict.fromkeys(known) if one and any(key.endswith(f"_{one}") for key in topics)]


def _joints_of(key: str, contract: Contract | None) -> JointStates | None:
    if contract is None or contract.vector_codec is None:
        return None
    units = tuple(element.unit for element in contract.elements)
    return JointStates.of(
        KeyColumns(key=key, role=contract.role, codec=contract.vector_codec, names=contract.names, units=units)
    )


def _elements_of(contract: Contract | None, role: str) -> tuple[Element, ...]:
    """Return the elements of a vector of a role; of anything else none."""
    is_one = contract is not None and contract.role == role and contract.vector_codec is not None
    return contract.elements if contract is not None and is_one else ()


def _data(message: Message) -> bytes:
    return message.data


def _event_of(message: Message) -> Mapping[str, Any] | None:
    """Return an event with when it says that it happened among its details; None for what is none."""
    event = codec.parse_facts(message.data)
    detail = event.get("detail", {})
    if not {"name", "severity", "source"} <= event.keys() or not isinstance(detail, dict):
        return None
    severity = str(event["severity"])
    if severity not in messages.LEVELS:
        return None
    return {**event, "severity": severity, "detail": {"wall_ns": event.get("wall_ns"), **detail}}


def _integer(row: Sequence[int], _: int) -> bytes:
    return messages.integer(row[0])


def _planar(stamp_ns: int, frame: str, values: Sequence[float]) -> bytes:
    vx, vy, wz = values
    return messages.twist(stamp_ns, frame, (vx, vy, 0.0), (0.0, 0.0, wz))


def _utf8(message: Message) -> str | None:
    try:
        return message.data.decode()
    except UnicodeDecodeError:
        return None


def _cloud_of(message: Message) -> PointCloud | None:
    try:
        return decoded(message.data)
    except BadCloud:
        return None


def _frame(name: str, what: str) -> str:
    return f"{'_'.join(_tokens(name))}_{what}"


def _tokens(name: str) -> list[str]:
    """Return a name as parts of a topic's name: letters, digits and single underscores, no digit first."""
    parts = (re.sub(r"_{2,}", "_", re.sub(r"[^A-Za-z0-9]", "_", part)).strip("_") for part in re.split("[:/]", name))
    found = [f"n{part}" if part[0].isdigit() else part for part in parts if part]
    return found or ["key"]


def facts_of(key: str, contract: Contract | None) -> Mapping[str, str]:
    """Return what the channel of a topic says of its key: its name, and its contract with names and units."""
    said = {} if contract is None else {"contract": msgspec.json.encode(contract).decode()}
    return {"key": key, **said}
