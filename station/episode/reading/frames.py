"""Pictures and clouds of an episode: which cameras, depth and lidars there are, and each frame with its time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from station.bus import keys
from station.contract import DEPTH_STEP_M
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.storage import pictures
from station.episode.storage.bulk import CLOUD
from station.optics import Optics, of_facts


class Frame(NamedTuple):
    """One picture, or one cloud.

    Times are nanoseconds since the Unix epoch on the episode's clock: `captured_ns` when it was taken (when it was
    written, where the camera does not say), `log_ns` arrival at the recorder. `data` is the file, byte for byte;
    of a compacted episode one that was made of its video; of depth it is the PNG file; of a lidar a cloud as in
    `station.point_cloud`.
    """

    data: bytes
    captured_ns: int
    log_ns: int
    sequence: int


def cameras(reader: EpisodeReader) -> dict[str, str]:
    """Return the key of each camera of an episode by the camera's name, sorted.

    Any key whose recorded contract says JPEG is one; a key that is not named as ours are is called by its whole name.
    """
    return {topic.removeprefix(keys.camera_image("")): topic for topic in _topics(reader, pictures.COLOUR)}


def depths(reader: EpisodeReader) -> dict[str, str]:
    """Return the key of each camera's depth by the camera's name, sorted; its recorded contract says so."""
    return {pictures.camera_of(topic): topic for topic in _topics(reader, pictures.DEPTH)}


def lidars(reader: EpisodeReader) -> dict[str, str]:
    """Return the key of each lidar's clouds by the lidar's name, sorted; its recorded contract says so."""
    return {topic.removeprefix(keys.lidar_cloud("")): topic for topic in _topics(reader, CLOUD)}


def all_pictures(reader: EpisodeReader) -> dict[str, str]:
    """Return the keys of cameras and of their depth, by what they are called beside each other, sorted."""
    found = {**cameras(reader), **{pictures.title_of(topic): topic for topic in depths(reader).values()}}
    return dict(sorted(found.items()))


def step_m(reader: EpisodeReader, topic: str) -> float:
    """Return what a step of a key's depth pictures is, by its recorded contract [m]."""
    said = (channel.contract.step_m for channel in reader.channels() if channel.topic == topic and channel.contract)
    return next(filter(None, said), DEPTH_STEP_M)


def optics(reader: EpisodeReader) -> tuple[dict[str, Optics], dict[str, str]]:
    """Return the stated optics of each key of pictures; and of those that state what cannot be, why."""
    found: dict[str, Optics] = {}
    why_not: dict[str, str] = {}
    known = set(all_pictures(reader).values())
    told = (one for facts in (*reader.manifest.cameras, *reader.manifest.servers.values())
            for one in pictures.stated(facts))  # fmt: skip
    for facts in told:
        if isinstance(key := facts.get("key"), str) and key in known:
            try:
                if any(stated := of_facts(facts)):
                    found[key] = stated
            except ValueError as error:
                why_not[key] = str(error)
    return found, why_not


def frames(reader: EpisodeReader, topic: str) -> Iterator[Frame]:
    """Iterate over the pictures, or clouds, of a key in order of arrival, one at a time in memory."""
    for message in reader.messages([topic], stamps=True):
        if not message.channel.is_deletion:
            yield Frame(message.data, captured_ns(message), message.log_ns, message.sequence)


def captured_ns(message: Message) -> int:
    """Return when a picture or cloud was taken, on the episode's clock [ns]; it needs the exact stamp of its write."""
    return pictures.captured_ns(message.publish_ns, message.stamp)


def _topics(reader: EpisodeReader, form: str) -> list[str]:
    """Return the keys whose recorded contracts say that they hold values of a codec, sorted."""
    return sorted({each.topic for each in reader.channels() if each.contract and each.contract.codec == form})
