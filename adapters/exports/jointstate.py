"""Joints as ROS 2's ``sensor_msgs/msg/JointState`` in an MCAP file: Rerun and others draw them by name with no code.

``EPISODE.mcap`` has a topic per key that holds joint positions, called like the key. The name of a joint is that of its
element without ``_pos``; velocities and efforts are given where the key holds them for all of its joints. Log and
publish times and sequence numbers are those of the recording; the header's stamp is the publish time.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

from mcap.writer import Writer

from adapters.exports.named_rows import Plan, Rows
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

_POSITION = "_pos"
_ALSO = (("_vel", "rad/s"), ("_torque", "N m"))
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
            data = kinds[row.key].encode(row.values, row.publish_ns)
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
        places: Place of each joint's position [rad] among the numbers of the key, then of each velocity [rad/s], then
            of each effort [N m]; n each, or none of the latter two.

    Attributes:
        places: Of all of them, in one tuple.

    All that never changes in a message is laid out once; what is left is the stamp and the numbers.
    """

    def __init__(self, joints: Sequence[str], places: Sequence[Sequence[int]]) -> None:
        self.places = tuple(place for each in places for place in each)
        frame_id = struct.pack("<I1s", 1, b"\x00")
        body = _aligned(bytes(_STAMP.size) + frame_id) + struct.pack("<I", len(joints))
        for joint in joints:
            text = joint.encode() + b"\x00"
            body = _aligned(body + struct.pack("<I", len(text)) + text)
        self._names = body[_STAMP.size :]
        self._parts: list[bytes | float] = []
        self._slots: list[int] = []
        layout, size = "<", len(body)
        for each in places:
            head = _list_head(size, len(each))
            self._parts.append(head)
            self._slots += range(len(self._parts), len(self._parts) + len(each))
            self._parts += [0.0] * len(each)
            layout += f"{len(head)}s{len(each)}d"
            size += len(head) + 8 * len(each)
        self._tail = struct.Struct(layout).pack

    @classmethod
    def of(cls, columns: KeyColumns) -> JointStates | None:
        """Return what makes messages of a key; None where it holds no joint positions."""
        place = {named: index for index, named in enumerate(zip(columns.names, columns.units, strict=True))}
        joints = [name.removesuffix(_POSITION) for name, unit in place if name.endswith(_POSITION) and unit == "rad"]
        if not joints:
            return None
        wanted = [[(joint + ending, unit) for joint in joints] for ending, unit in ((_POSITION, "rad"), *_ALSO)]
        return cls(joints, [[place[one] for one in each] if place.keys() >= {*each} else [] for each in wanted])

    def encode(self, values: Sequence[float], stamp_ns: int) -> bytes:
        """Return a value of the key, with when it was written [ns since the epoch], as CDR."""
        parts = self._parts.copy()
        for slot, place in zip(self._slots, self.places, strict=True):
            parts[slot] = values[place]
        return _LITTLE_ENDIAN_CDR + _STAMP.pack(*divmod(stamp_ns, _NANOSECONDS)) + self._names + self._tail(*parts)


def _list_head(at: int, count: int) -> bytes:
    """Return the length of a list of doubles that begins at a byte of the body, and the gap before its first."""
    head = struct.pack("<I", count)
    return head + bytes(-(at + len(head)) % 8) if count else head


def _aligned(body: bytes) -> bytes:
    return body + bytes(-len(body) % 4)
