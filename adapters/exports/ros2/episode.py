"""One episode as a bag: every write of every key, in order of arrival, one chunk of the recording in memory."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from adapters.exports.named_rows import Plan
from adapters.exports.ros2 import messages
from adapters.exports.ros2.bag import Bag
from adapters.exports.ros2.topics import DIAGNOSTICS, SHARED, TF_STATIC, Routes, facts_of
from station.episode.reading.frames import captured_ns
from station.episode.reading.reader import EpisodeReader, open_episode
from station.errors import EpisodeError, did_you_mean
from station.export.kind import ShardResult, Source

_NANOSECONDS = 1_000_000_000
_OPERATOR = "operator"  # who says a mark


def routes(source: Source, plan: Plan) -> tuple[EpisodeReader, Routes]:
    """Return the reader of an episode, and what becomes of its keys.

    Raises:
        EpisodeError: it has not a key that was asked for, or one has no topic, or none has; names key and cure.
    """
    reader = open_episode(Path(source.folder))
    for key in plan.keys:
        if key not in reader.recorded:
            raise EpisodeError(f"{source.episode_id}: no key {key!r} in it{did_you_mean(key, reader.recorded)}")
    found = Routes(reader, plan.keys)
    for key in plan.keys:
        if key in found.left_out:
            raise EpisodeError(f"{source.episode_id}: key {key!r}: {found.left_out[key]}; leave it out")
    if not found.routes:
        raise EpisodeError(f"{source.episode_id}: no key in it that anything describes, so nothing to export")
    return reader, found


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the bag of one episode; see `ExportKind.convert`."""
    reader, found = routes(source, plan)
    place = folder / source.episode_id
    place.mkdir()
    unfit: Counter[str] = Counter()
    with (place / f"{source.episode_id}_0.mcap").open("xb") as file:
        bag = Bag(place, file, _about(reader))
        for key, route in found.routes.items():
            for topic in route.topics:
                facts = {} if topic.name in SHARED else facts_of(key, route.contract)
                bag.add_topic(topic.name, topic.type, is_latched=topic.name == TF_STATIC, facts=facts)
        _fill(reader, found, bag, unfit)
        bag.finish()
    return ShardResult(
        seconds=bag.duration_ns / _NANOSECONDS,
        rows=sum(bag.counts.values()),
        facts={"topics": dict(bag.counts), "unfit": dict(unfit), "left_out": found.left_out},
    )


def _fill(reader: EpisodeReader, found: Routes, bag: Bag, unfit: Counter[str]) -> None:
    if reader.manifest.marks:
        bag.add_topic(DIAGNOSTICS, messages.DIAGNOSTICS, facts={})
    for mark in reader.manifest.marks:
        at_ns = reader.start_ns + round(mark.at_s * _NANOSECONDS)
        said = {"name": mark.label, "severity": "info", "source": _OPERATOR, "detail": {}}
        bag.write(DIAGNOSTICS, messages.diagnostics(at_ns, said), log_ns=at_ns, publish_ns=at_ns)
    if found.mounts:
        bag.add_topic(TF_STATIC, messages.TRANSFORMS, is_latched=True, facts={})
    for one in found.mounts:
        at_ns = reader.start_ns
        placed = messages.transform(at_ns, one.parent, one.child, one.values)
        bag.write(TF_STATIC, placed, log_ns=at_ns, publish_ns=at_ns)
    for message in reader.messages(found.routes.keys(), stamps=any(one.is_captured for one in found.routes.values())):
        if message.channel.is_deletion:
            continue
        route = found.routes[message.topic]
        value = route.read(message)
        if value is None:
            unfit[message.topic] += 1
            continue
        stamp_ns = captured_ns(message) if route.is_captured else message.publish_ns
        for topic in route.topics:
            data = topic.encode(value, stamp_ns)
            if data is not None:
                bag.write(
                    topic.name, data, log_ns=message.log_ns, publish_ns=message.publish_ns, sequence=message.sequence
                )


def _about(reader: EpisodeReader) -> dict[str, str]:
    """Return what the metadata of a bag say of its episode."""
    manifest = reader.manifest
    said = {
        "episode_id": reader.episode_id,
        "task": manifest.task.name,
        "instruction": manifest.task.instruction,
        "robot": manifest.robot.suffix,
        "start_ns": str(reader.start_ns),
    }
    return {name: value for name, value in said.items() if value}
