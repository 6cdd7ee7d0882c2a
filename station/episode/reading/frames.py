"""The pictures of an episode: which cameras there are, and each frame with the time at which it was taken."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from station.bus import keys
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.storage import pictures
from station.optics import Optics, of_facts


class Frame(NamedTuple):
    """One picture.

    Times are nanoseconds since the Unix epoch on the episode's clock: `captured_ns` when it was taken (when it was
    written, where the camera does not say), `log_ns` arrival at the recorder. `jpeg` is the file, byte for byte;
    of a compacted episode one that was made of its video.
    """

    jpeg: bytes
    captured_ns: int
    log_ns: int
    sequence: int


def cameras(reader: EpisodeReader) -> dict[str, str]:
    """Return the key of each camera of an episode by the camera's name, sorted.

    Any key whose recorded contract says JPEG is one; a key that is not named as ours are is called by its whole name.
    """
    found = {channel.topic for channel in reader.channels() if _is_camera(channel.contract)}
    return {topic.removeprefix(keys.camera_image("")): topic for topic in sorted(found)}


def optics(reader: EpisodeReader) -> tuple[dict[str, Optics], dict[str, str]]:
    """Return the stated optics of each camera by its key; and of those that state what cannot be, why."""
    found: dict[str, Optics] = {}
    why_not: dict[str, str] = {}
    cameras_of = set(cameras(reader).values())
    for facts in (*reader.manifest.cameras, *reader.manifest.servers.values()):
        if isinstance(key := facts.get("key"), str) and key in cameras_of:
            try:
                if any(stated := of_facts(facts)):
                    found[key] = stated
            except ValueError as error:
                why_not[key] = str(error)
    return found, why_not


def frames(reader: EpisodeReader, topic: str) -> Iterator[Frame]:
    """Iterate over the pictures of a key in order of arrival, one at a time in memory."""
    for message in reader.messages([topic], stamps=True):
        if not message.channel.is_deletion:
            yield Frame(message.data, captured_ns(message), message.log_ns, message.sequence)


def captured_ns(message: Message) -> int:
    """Return when a picture was taken, on the episode's clock [ns]: it needs the exact stamp of its write."""
    return pictures.captured_ns(message.publish_ns, message.stamp)


def _is_camera(contract: object) -> bool:
    return getattr(contract, "codec", None) == pictures.FORMAT
