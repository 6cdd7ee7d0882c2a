"""Reads bags with the readers of others: rosbags, which reads metadata and messages, and the mcap package."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from adapters.exports.ros2 import kind
from station.export.kind import ShardResult, Source

HUMBLE: Any = get_typestore(Stores.ROS2_HUMBLE)


class Received(NamedTuple):
    """A message as rosbags reads it."""

    log_ns: int
    message: Any

    @property
    def stamp_ns(self) -> int:
        return ns_of(self.message.header)


def exported(episode: Path, out: Path, *keys: str) -> tuple[Path, ShardResult]:
    """Export an episode; return its bag, and what is said of it."""
    source = Source(episode_id=episode.name, folder=str(episode))
    out.mkdir()
    plan = kind.prepare([source], kind.BagOptions(keys=keys))
    return out / episode.name, kind.convert(source, plan, out)


def connections(bag: Path) -> dict[str, Any]:
    """Return the topics of a bag as rosbags finds them (`rosbags.interfaces.Connection`)."""
    with Reader(bag) as reader:
        found = {one.topic: one for one in reader.connections}
        assert len(found) == len(reader.connections)
        return found


def read(bag: Path, topic: str) -> list[Received]:
    """Return the messages of a topic, decoded with the types of Humble."""
    with Reader(bag) as reader:
        wanted = [one for one in reader.connections if one.topic == topic]
        return [
            Received(log_ns, HUMBLE.deserialize_cdr(data, connection.msgtype))
            for connection, log_ns, data in reader.messages(connections=wanted)
        ]


def records(bag: Path, topic: str) -> list[tuple[int, int, int]]:
    """Return arrival, writing and number of each message of a topic, as the mcap package reads its file."""
    (path,) = bag.glob("*.mcap")
    with path.open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages(topics=[topic], log_time_order=False)
        return [(message.log_time, message.publish_time, message.sequence) for _, _, message in found]


def ns_of(header: Any) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def xyzw(quaternion: Any) -> list[float]:
    return [quaternion.x, quaternion.y, quaternion.z, quaternion.w]
