"""Checking an episode: one pass over the file, every number from the file, and a verdict with its reasons."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from station.bus import codec, keys
from station.episode import falls, interruptions, steps, stream_quality
from station.episode.manifest import MAX_STREAMS, Manifest, load_manifest, save_manifest
from station.episode.quality import FallSeen, Limits, Quality
from station.episode.reader import EpisodeReader, Message
from station.episode.rules import judge
from station.episode.step_quality import StepMeter
from station.errors import EpisodeError

_LOCK_STEP_PACE = "command"  # of a low-level server: it waits for a command after each state


def check(reader: EpisodeReader, limits: Limits | None = None) -> Quality:
    """Measure an episode and judge it.

    A torn or unfinished file is measured as far as it goes.
    """
    topics = reader.topics()
    start_ns = _start_ns(reader)
    counter = stream_quality.StreamCounter()
    meters = {robot: StepMeter(robot, start_ns) for robot in steps.robots(topics)}
    joiners = {robot: steps.StepJoiner(robot, context=meter.context) for robot, meter in meters.items()}
    events: list[tuple[float, dict[str, Any]]] = []
    for message in reader.messages():
        counter.feed(message)
        if message.topic == keys.EVENT:
            event = _event(message)
            events.append(((message.log_ns - start_ns) * 1e-9 - interruptions.late_s(event), event))
        for robot, joiner in joiners.items():
            step = joiner.feed(message)
            if step is not None:
                meters[robot].feed(step)
    for robot, joiner in joiners.items():
        for step in joiner.finish():
            meters[robot].feed(step)
    quality = _assemble(reader, counter, meters, events, start_ns)
    quality.verdict, quality.reasons = judge(quality, limits or Limits())
    return quality


def write_measured(folder: Path, quality: Quality) -> Manifest:
    """Put what was measured into the manifest of an episode, as its ``quality``, and return the manifest.

    Raises:
        EpisodeError: the episode is not finished (its recorder would overwrite it), or the disk refused.
    """
    if not quality.is_finished:
        raise EpisodeError(
            f"episode {quality.episode_id}: not finished, its recorder still owns the manifest; "
            "stop the recording and check again (an episode whose recorder was killed keeps its manifest as it is)"
        )
    manifest = load_manifest(folder)
    listed = msgspec.structs.replace(quality, streams=quality.streams[:MAX_STREAMS])  # as the manifest's own
    manifest.quality = {"measured_at": datetime.now(UTC).isoformat(), **msgspec.to_builtins(listed)}
    save_manifest(manifest, folder)
    return manifest


def is_lock_step(manifest: Manifest) -> bool:
    """Whether a server of the episode paced itself by states instead of by the clock."""
    return any(_paces_by_state(facts) for facts in manifest.servers.values())


def _paces_by_state(facts: Mapping[str, Any]) -> bool:
    config = facts.get("config")
    return facts.get("pace") == _LOCK_STEP_PACE or (
        isinstance(config, Mapping) and config.get("pace") == _LOCK_STEP_PACE
    )


def _assemble(
    reader: EpisodeReader,
    counter: stream_quality.StreamCounter,
    meters: dict[str, StepMeter],
    events: list[tuple[float, dict[str, Any]]],
    start_ns: int,
) -> Quality:
    manifest, flags, recorder = reader.manifest, reader.manifest.quality_flags, reader.manifest.recorder
    drops = reader.drops()
    streams = counter.streams(start_ns, drops)
    names = Counter(str(event.get("name", "")) for _, event in events)
    reported = [_fall(at_s, event) for at_s, event in events if event.get("name") == "fall"]
    seen = falls.merged(reported, [fall for meter in meters.values() for fall in meter.falls()])
    found = interruptions.find(events, manifest)
    return Quality(
        episode_id=reader.episode_id,
        duration_s=max((s.last_s for s in streams), default=0.0) - min((s.first_s for s in streams), default=0.0),
        messages=counter.messages,
        streams=streams,
        steps=[meter.result() for meter in meters.values()],
        rivals=stream_quality.rivals(streams),
        falls=len(seen),
        falls_seen=seen,
        resets=names["operator-reset"],
        estops=names["estop"],
        interruptions=found,
        bus_lost=sum(item.kind == "bus-lost" for item in found),
        events=dict(sorted(names.items())),
        recorder_restarts=recorder.restarts,
        dropped=max(recorder.dropped, drops.total),
        dropped_bulky=drops.bulky,
        dropped_keys=drops.by_key(20),
        holes=len(manifest.holes),
        backend=recorder.backend,
        is_lossless=recorder.is_lossless,
        lock_step=is_lock_step(manifest),
        is_finished=not reader.is_active,
        torn=reader.torn,
        success=flags.success,
        discarded=flags.discarded,
    )


def _start_ns(reader: EpisodeReader) -> int:
    """Instant that times are told from: the anchor of the episode, else its first message [ns since the epoch]."""
    if reader.anchor is not None:
        return int(reader.anchor.wall_ns)
    return int(min((stream.first_ns for stream in reader.streams() if stream.count), default=0))


def _event(message: Message) -> dict[str, Any]:
    try:
        value = codec.parse_json(message.data)
    except codec.BadValue:
        return {}
    return value if isinstance(value, dict) else {}


def _fall(at_s: float, event: Mapping[str, Any]) -> FallSeen:
    detail = {**event, **(event["detail"] if isinstance(event.get("detail"), dict) else {})}
    tilt, contacts = detail.get("tilt_rad"), detail.get("contacts")
    return FallSeen(
        at_s=at_s,
        robot=str(detail.get("robot", "")),
        tilt_rad=float(tilt) if isinstance(tilt, (int, float)) else None,
        seen_by="event",
        contacts=[str(name) for name in contacts] if isinstance(contacts, (list, tuple)) else [],
    )
