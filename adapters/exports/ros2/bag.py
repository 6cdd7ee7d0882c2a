"""A bag on the disk as rosbag2 has it: a folder with ``metadata.yaml`` and one MCAP file of profile ``ros2``.

The file is made by the mcap library and not by rosbags' own writer, which knows one time of a message and no number of
it. The form of the metadata is version 8 (``rosbag2_storage/yaml.hpp`` and ``qos.cpp`` of ros2/rosbag2): Humble reads
it, and newer releases read older forms; version 9 is no text for Humble.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from mcap.writer import Writer

from adapters.exports.ros2 import ros_types

METADATA = "metadata.yaml"

_VERSION = 8
_KEEP_LAST, _RELIABLE, _TRANSIENT_LOCAL, _VOLATILE, _AUTOMATIC = 1, 1, 1, 2, 1  # rmw/types.h
_DEPTH = 10
_FOR_EVER = {"sec": 9_223_372_036, "nsec": 854_775_807}


class Bag:
    """A bag while it is written.

    Args:
        folder: Of the bag, which exists and is empty; its name is that of the bag.
        file: For its messages, open for writing.
        about: Facts for people and programs, in the metadata.

    Attributes:
        counts: Messages so far, by topic.
    """

    def __init__(self, folder: Path, file: BinaryIO, about: Mapping[str, str]) -> None:
        self.counts: dict[str, int] = {}
        self._folder, self._about = folder, dict(about)
        self._name = Path(file.name).name
        self._writer = Writer(file)
        self._writer.start(profile="ros2", library="teleop-station")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._topics: dict[str, dict[str, Any]] = {}
        self._first_ns = self._last_ns = 0

    def add_topic(self, topic: str, type_name: str, *, is_latched: bool = False, facts: Mapping[str, str]) -> None:
        """Announce a topic; one that is there already stays as it is.

        Args:
            topic: Full name.
            type_name: Its type.
            is_latched: Whether who subscribes later gets the newest message too.
            facts: Of its channel, for whoever reads the MCAP file; ROS passes over them.
        """
        if topic in self._channels:
            return
        text, digest = ros_types.definition(type_name)
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text.encode())
        qos = yaml.safe_dump([_qos(is_latched=is_latched)], sort_keys=False)
        self._topics[topic] = {
            "name": topic, "type": type_name, "serialization_format": "cdr", "offered_qos_profiles": qos,
            "type_description_hash": digest,
        }  # fmt: skip
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": digest, **facts}
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[type_name], metadata)
        self.counts[topic] = 0

    def write(self, topic: str, data: bytes, *, log_ns: int, publish_ns: int, sequence: int = 0) -> None:
        """Write a message of a topic that was announced: when it arrived and when it was written [ns], its number."""
        self._writer.add_message(self._channels[topic], log_ns, data, publish_ns, sequence)
        self.counts[topic] += 1
        self._first_ns = min(self._first_ns or log_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)

    @property
    def duration_ns(self) -> int:
        """From the first arrival to the last [ns]."""
        return self._last_ns - self._first_ns

    def finish(self) -> None:
        """Write the index and the metadata."""
        facts = self._metadata()
        self._writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(facts, sort_keys=False)})
        self._writer.finish()
        text = yaml.safe_dump({"rosbag2_bagfile_information": facts}, sort_keys=False, allow_unicode=True)
        (self._folder / METADATA).write_text(text, encoding="utf-8")

    def _metadata(self) -> dict[str, Any]:
        count = sum(self.counts.values())
        when = {
            "duration": {"nanoseconds": self.duration_ns},
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "message_count": count,
        }
        topics = [{"topic_metadata": one, "message_count": self.counts[name]} for name, one in self._topics.items()]
        return {
            "version": _VERSION,
            "storage_identifier": "mcap",
            **{name: _copy(value) for name, value in when.items()},
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [{"path": self._name, **{name: _copy(value) for name, value in when.items()}}],
            "custom_data": self._about,
            "ros_distro": "teleop-station",
        }


def _copy(value: Any) -> Any:
    """Return a value that YAML does not write as a reference to another, which rosbags' reader of it refuses."""
    return dict(value) if isinstance(value, dict) else value


def _qos(*, is_latched: bool) -> dict[str, Any]:
    """Return a profile: reliable, so that whoever subscribes gets it, whether it asks for that or for best effort."""
    return {
        "history": _KEEP_LAST, "depth": _DEPTH, "reliability": _RELIABLE,
        "durability": _TRANSIENT_LOCAL if is_latched else _VOLATILE,
        "deadline": dict(_FOR_EVER), "lifespan": dict(_FOR_EVER), "liveliness": _AUTOMATIC,
        "liveliness_lease_duration": dict(_FOR_EVER), "avoid_ros_namespace_conventions": False,
    }  # fmt: skip
