"""Joints as ROS 2's ``sensor_msgs/msg/JointState`` in an MCAP file: Rerun and others draw them by name with no code.

``EPISODE.mcap`` has a topic per key that holds joint positions, called like the key. The name of a joint is that of its
element without ``_pos``; velocities are given where the key holds them for all of its joints. Log and publish times and
sequence numbers are those of the recording; the header's stamp is the publish time.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

from mcap.writer import Writer

from adapters.exports.named_rows import Plan, Row, Rows
from station.errors import EpisodeError
from station.export.columns import KeyColumns
from station.export.kind import ShardResult, Source

SCHEMA_NAME = "sensor_msgs/msg/JointState"
_LINE = "=" * 80
SCHEMA = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

_POSITION, _VELOCITY = "_pos", "_vel"
_LITTLE_ENDIAN_CDR = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_NANOSECONDS = 1_000_000_000


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the joints of one episode, message by message.

    Raises:
        EpisodeError: no key holds joint positions, or one that was asked for does not.
    """
    rows = Rows(source, plan.keys)
    kinds = _kinds(rows, source, plan)
    rows.narrow(kinds)
    with (folder / f"{source.episode_id}.mcap").open("xb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="teleop-station")
        schema = writer.register_schema(SCHEMA_NAME, "ros2msg", SCHEMA.encode())
        channels = {key: writer.register_channel(key, "cdr", schema, {}) for key in kinds}
        for row in rows:
            data = kinds[row.key].encode(row)
            writer.add_message(channels[row.key], row.log_ns, data, row.publish_ns, row.sequence)
        writer.finish()
    return rows.made()


def inspect(source: Source, plan: Plan) -> list[str]:
    """Check whether an episode can be converted; see `ExportKind.inspect`."""
    _kinds(Rows(source, plan.keys), source, plan)
    return []


def _kinds(rows: Rows, source: Source, plan: Plan) -> dict[str, JointStates]:
    """Return what makes the messages of each key that holds joint positions."""
    kinds = {key: found for key, columns in rows.columns.items() if (found := JointStates.of(columns)) is not None}
    if without := [key for key in plan.keys if key not in kinds]:
        raise EpisodeError(f"{source.episode_id}: key {without[0]!r} holds no joint positions; leave it out")
    if not kinds:
        raise EpisodeError(f"{source.episode_id}: no key in it holds joint positions, so nothing to export")
    return kinds


class JointStates:
    """Makes messages of the values of a key.

    Args:
        joints: Names of n joints.
        positions: Place of each joint's position [rad] among the numbers of the key.
        velocities: Place of each joint's velocity [rad/s], or nothing.

    All that never changes in a message is laid out once; what is left is the stamp and the numbers.
    """

    def __init__(self, joints: Sequence[str], positions: Sequence[int], velocities: Sequence[int]) -> None:
        self._places = [*positions, *velocities]
        frame_id = struct.pack("<I1s", 1, b"\x00")
        body = _aligned(bytes(_STAMP.size) + frame_id) + struct.pack("<I", len(joints))
        for joint in joints:
            text = joint.encode() + b"\x00"
            body = _aligned(body + struct.pack("<I", len(text)) + text)
        self._names = body[_STAMP.size :]
        first = _list_head(len(body), len(positions))
        second = _list_head(len(body) + len(first) + 8 * len(positions), len(velocities))
        self._tail = struct.Struct(f"<{len(first)}s{len(positions)}d{len(second)}s{len(velocities)}dI").pack
        self._heads, self._count = (first, second), len(positions)

    @classmethod
    def of(cls, columns: KeyColumns) -> JointStates | None:
        """Return what makes messages of a key; None where it holds no joint positions."""
        place = {name: index for index, name in enumerate(columns.names)}
        joints = [
            name.removesuffix(_POSITION)
            for name, unit in zip(columns.names, columns.units, strict=True)
            if name.endswith(_POSITION) and unit == "rad"
        ]
        moving = [place[joint + _VELOCITY] for joint in joints if joint + _VELOCITY in place]
        if not joints:
            return None
        return cls(joints, [place[joint + _POSITION] for joint in joints], moving if len(moving) == len(joints) else [])

    def encode(self, row: Row) -> bytes:
        """Return a row as CDR."""
        stamp = _STAMP.pack(*divmod(row.publish_ns, _NANOSECONDS))
        numbers = [row.values[place] for place in self._places]
        first, second = self._heads
        tail = self._tail(first, *numbers[: self._count], second, *numbers[self._count :], 0)
        return _LITTLE_ENDIAN_CDR + stamp + self._names + tail


def _list_head(at: int, count: int) -> bytes:
    """Return the length of a list of doubles that begins at a byte of the body, and the gap before its first."""
    head = struct.pack("<I", count)
    return head + bytes(-(at + len(head)) % 8) if count else head


def _aligned(body: bytes) -> bytes:
    return body + bytes(-len(body) % 4)
