"""Checking an episode: one pass over the file, every number from the file, and a verdict with its reasons."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from station.bus import codec, keys
from station.bus.tap import not_mirrored
from station.contract import Contract
from station.control.tracking import VELOCITIES
from station.episode.quality import (
    arms,
    falls,
    interruptions,
    motion,
    pauses,
    plausibility,
    presence,
    rule_file,
    swapped_cameras,
    timing,
)
from station.episode.quality.alignment import AlignmentMeter
from station.episode.quality.blocks import Blocks
from station.episode.quality.cameras import CameraMeter, stated_hz
from station.episode.quality.finding_parts import KeyChanges
from station.episode.quality.findings import FallSeen, Quality
from station.episode.quality.picture_contents import PictureMeter
from station.episode.quality.plausibility import Feed
from station.episode.quality.policy_steps import StepMeter
from station.episode.quality.presence import Heartbeats
from station.episode.quality.rule_file import RuleBook
from station.episode.quality.rules import judge
from station.episode.quality.streams import StreamCounter, rivals
from station.episode.reading import frames, steps
from station.episode.reading.messages import Channel, Message
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step, StepJoiner
from station.episode.storage import layout
from station.episode.storage.drops import Drops
from station.episode.storage.file_hashes import changes, measure
from station.episode.storage.manifest import MAX_STREAMS, Manifest, save_manifest
from station.episode.storage.manifest_copy import changed_fields, manifest_to_change
from station.episode.storage.manifest_parts import AuditFound, RecordedFile, Recorder
from station.errors import EpisodeError
from station.protocols import Floats

_LONGEST_NAME, _MOST_CONTACTS = 60, 20  # of what an event tells of a fall; anybody may write events
_LOCK_STEP_PACE = "command"  # of a low-level server: it waits for a command after each state

DELETED = "deleted"
"""Stands for the command of a deletion, which may have been any: DEL, an expiry, FLUSHALL."""

_MOST = 1000  # kinds; a client may invent keys
_TOLD_EACH = 2000  # messages


def check(
    reader: EpisodeReader,
    book: RuleBook | None = None,
    tell: Callable[[float], None] | None = None,
    *,
    audit: AuditFound | None = None,
) -> Quality:
    """Measure an episode and judge it, by our own rules where no others are given.

    A torn or unfinished file is measured as far as it goes.

    Args:
        reader: The episode.
        book: The rules.
        tell: Is told now and then how far it has come, from the start of the episode [s].
        audit: What an audit found, to be judged too. Where none compared anything, what an earlier one found of these
            files stands: a check that audits nothing makes no verdict better.
    """
    rules = book or rule_file.shipped()
    quality = _assemble(reader, Measurements(reader, tell))
    quality.audit = (
        audit if audit is not None and audit.compared else _audited_before(reader.manifest, quality) or audit
    )
    quality.not_judged = timing.not_judged(quality)
    quality.verdict, quality.reasons = judge(quality, rules.limits)
    quality.rules = list(rules.files)
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
    manifest = manifest_to_change(folder)
    listed = msgspec.structs.replace(  # as the manifest's own
        quality,
        streams=quality.streams[:MAX_STREAMS],
        cameras=quality.cameras[:MAX_STREAMS],
        pictures=quality.pictures[:MAX_STREAMS],
        presence=quality.presence[:MAX_STREAMS],
    )
    manifest.quality = {"measured_at": datetime.now(UTC).isoformat(), **msgspec.to_builtins(listed)}
    save_manifest(manifest, folder)
    return manifest


def files_of(reader: EpisodeReader) -> list[RecordedFile]:
    """Return what tells the files of a finished episode from others; nothing of one whose file has another name.

    Raises:
        EpisodeError: one cannot be read.
    """
    if reader.path.name != layout.SIGNALS:
        return []
    try:
        return measure(reader.folder)
    except OSError as error:
        raise EpisodeError(f"{error.filename or reader.folder}: cannot be read: {error.strerror}") from error


def _audited_before(manifest: Manifest, quality: Quality) -> AuditFound | None:
    """Return what an audit found of the files that were measured, by what an earlier check wrote; None for nothing."""
    try:
        files = msgspec.convert(manifest.quality.get("files"), list[RecordedFile])
        found = msgspec.convert(manifest.quality.get("audit"), AuditFound)
    except msgspec.ValidationError:
        return None
    is_same = files == quality.files and manifest.quality.get("manifest_changed") == quality.manifest_changed
    return found if files and is_same and found.compared else None


def is_lock_step(manifest: Manifest) -> bool:
    """Whether a server of the episode paced itself by states instead of by the clock."""
    return any(_paces_by_state(facts) for facts in manifest.servers.values())


def velocity_curves(reader: EpisodeReader, robot: str) -> Floats:
    """Return how a robot followed velocities, as `station.control.tracking.VelocityTracking.curves`, shape (n, 7).

    Times are since the start of the episode [s]. Where no velocity was commanded n is 0.
    """
    asked = reader.contract(keys.command_used(robot)) if robot else None
    if asked is None or not set(VELOCITIES) <= set(asked.names):
        return np.empty((0, 7))
    meter = step_meter(reader, robot)
    joiner = StepJoiner(robot, context=meter.context)
    for message in reader.messages(joiner.topics):
        if (step := joiner.feed(message)) is not None:
            meter.feed(step)
    for step in joiner.finish():
        meter.feed(step)
    return meter.velocity_curves()


def control_period_s(manifest: Manifest, robot: str) -> float | None:
    """Return the control period of a robot, as its server stated it [s]; None where it did not."""
    for facts in manifest.servers.values():
        rates = facts.get("rates")
        hz = rates.get("control_hz") if facts.get("robot") == robot and isinstance(rates, Mapping) else None
        if isinstance(hz, int | float) and 1.0 <= hz <= 10_000.0:
            return 1.0 / hz
    return None


def step_meter(reader: EpisodeReader, robot: str) -> StepMeter:
    """Return what measures the steps of a robot of an episode."""
    manifest = reader.manifest
    return StepMeter(
        robot, reader.start_ns, reader.contract, control_period_s(manifest, robot), listened_parts(manifest, robot)
    )


def listened_parts(manifest: Manifest, robot: str) -> dict[str, str]:
    """Return the part of its command that each policy of a robot listens to, as its server stated it.

    By what its steps call the policy; those that listen to all of it are not in it.
    """
    for facts in manifest.servers.values():
        if facts.get("robot") == robot and isinstance(policy := facts.get("policy"), Mapping):
            several = facts.get("policies")
            each = several if isinstance(several, Mapping) and several else {"": policy}
            told = {str(name): of.get("part") for name, of in each.items() if isinstance(of, Mapping)}
            return {name: part for name, part in told.items() if isinstance(part, str) and part}
    return {}


def _paces_by_state(facts: Mapping[str, Any]) -> bool:
    config = facts.get("config")
    return facts.get("pace") == _LOCK_STEP_PACE or (
        isinstance(config, Mapping) and config.get("pace") == _LOCK_STEP_PACE
    )


def _assemble(reader: EpisodeReader, measured: Measurements) -> Quality:
    manifest, flags, drops = reader.manifest, reader.manifest.quality_flags, reader.drops()
    counter, start_ns = measured.counter, measured.start_ns
    streams, commands = counter.streams(start_ns, drops, measured.ends), list(counter.commands())
    paused = pauses.find(commands, measured.ends)
    files = files_of(reader)
    span_s, cameras = presence.ends_s(manifest, streams), measured.cameras.result(streams, start_ns)
    pictures = measured.pictures.result(motion.moves(measured.motion))
    return Quality(
        episode_id=reader.episode_id,
        duration_s=max((s.last_s for s in streams), default=0.0) - min((s.first_s for s in streams), default=0.0),
        messages=counter.messages,
        streams=streams,
        steps=[meter.result(paused) for meter in measured.steps.values()],
        alignment=[meter.result() for meter in measured.alignment.values()],
        motion=[moved for meter in measured.motion if (moved := meter.result()) is not None],
        arms=[arm for meter in measured.arms if (arm := meter.result()) is not None],
        plausibility=[meter.result() for meter in measured.plausibility.values()],
        contract_differences=plausibility.differences(reader),
        cameras=cameras,
        pictures=pictures,
        swapped_cameras=swapped_cameras.find(reader, pictures),
        ends_s=span_s,
        presence=presence.find(streams, span_s, measured.ends, measured.heartbeats),
        silences=presence.silences(measured.heartbeats),
        no_pictures=presence.without_pictures(
            manifest, (stream.key for stream in streams if stream.count), measured.heartbeats
        ),
        rivals=rivals(commands, measured.ends),
        pauses=pauses.described(paused, start_ns),
        **_told(measured, manifest),
        **_recorded(manifest.recorder, drops),
        not_mirrored=measured.changes.not_mirrored(),
        deletions=measured.changes.deletions(),
        holes=len(manifest.holes) + manifest.holes_not_listed,
        lock_step=is_lock_step(manifest),
        times_of=timing.times_of(manifest),
        is_finished=not reader.is_active,
        torn=reader.torn,
        success=flags.success,
        discarded=flags.discarded,
        files=files,
        changed=changes(manifest.files, files),
        manifest_changed=changed_fields(manifest, reader.attachments()),
        shortened=manifest.shortened,
    )


def _told(measured: Measurements, manifest: Manifest) -> dict[str, Any]:
    """Return what follows from events: falls, stops, interruptions."""
    names = Counter(str(event.get("name", "")) for _, event in measured.events)
    reported = [_fall(at_s, event) for at_s, event in measured.events if event.get("name") == "fall"]
    seen = falls.merged(reported, [fall for meter in measured.steps.values() for fall in meter.falls()])
    found = interruptions.find(measured.events, manifest)
    return {
        "falls": len(seen),
        "falls_seen": seen,
        "resets": names["operator-reset"],
        "estops": names["estop"],
        "interruptions": found,
        "losses": presence.losses(measured.events, manifest),
        "bus_lost": sum(item.kind == "bus-lost" for item in found),
        "events": dict(sorted(names.items())),
    }


def _recorded(recorder: Recorder, drops: Drops) -> dict[str, Any]:
    """Return how the recorder fared."""
    return {
        "recorder_restarts": recorder.restarts,
        "dropped": max(recorder.dropped, drops.total),
        "dropped_bulky": drops.bulky,
        "dropped_keys": drops.by_key(20),
        "backend": recorder.backend,
        "is_lossless": recorder.is_lossless,
    }


def _fall(at_s: float, event: Mapping[str, Any]) -> FallSeen:
    detail = {**event, **(event["detail"] if isinstance(event.get("detail"), dict) else {})}
    tilt, contacts = detail.get("tilt_rad"), detail.get("contacts")
    listed = contacts if isinstance(contacts, list) else []
    return FallSeen(
        at_s=at_s,
        robot=str(detail.get("robot", ""))[:_LONGEST_NAME],
        tilt_rad=codec.number(tilt),
        seen_by="event",
        contacts=[str(name)[:_LONGEST_NAME] for name in listed[:_MOST_CONTACTS]],
    )


class Measurements:
    """The meters of an episode after they were fed with all of it.

    Attributes:
        start_ns: Instant that times are told from: the anchor of the episode, else its first message [ns since the
            epoch].
        counter: Counts every stream.
        steps, alignment: By robot.
        motion: One for each robot whose joints are told of.
        arms: One for each arm.
        plausibility: By robot.
        cameras: Counts pictures.
        pictures: Looks at them.
        changes: Counts changes of keys that are no values in the file.
        heartbeats: Which servers lived.
        events: Every event with its time from the start [s].
        ends: Where commands ended because their server said so.
    """

    def __init__(self, reader: EpisodeReader, tell: Callable[[float], None] | None = None) -> None:
        topics = reader.topics()
        self.start_ns = reader.start_ns
        self.counter = StreamCounter()
        self.steps = {robot: step_meter(reader, robot) for robot in steps.robots(topics)}
        self.alignment = {
            robot: AlignmentMeter(robot, steps.state_key(robot, topics), reader.contract) for robot in self.steps
        }
        self.motion = motion.meters(reader)
        self.arms = [arms.ArmMeter(robot) for robot in arms.robots(topics)]
        self.plausibility = plausibility.meters(reader, list(self.steps), is_lock_step=is_lock_step(reader.manifest))
        cameras = frames.all_pictures(reader)
        self._camera_keys = set(cameras.values())
        self.cameras = CameraMeter(cameras, stated_hz(reader.manifest))
        self.pictures = PictureMeter(reader)
        self.changes = ChangeCounter(self.start_ns, reader.contract)
        self.heartbeats = Heartbeats(self.start_ns)
        self.events: list[tuple[float, dict[str, Any]]] = []
        self.ends: list[pauses.End] = []
        self._blocks: defaultdict[str, Blocks] = defaultdict(Blocks)
        self._feeds: defaultdict[str, list[Feed]] = defaultdict(list)  # most keys are those of nobody here
        wanted = [meter.takes() for meter in self.motion] + [meter.takes() for meter in self.plausibility.values()]
        for takes in wanted:
            for key, take in takes.items():
                self._blocks[key].takes.append(take)
        for plausible in self.plausibility.values():
            for key, feed in plausible.feeds().items():
                self._feeds[key].append(feed)
        for key, blocks in self._blocks.items():
            self._feeds[key].append(blocks.feed)
        self._routes: dict[int, tuple[Feed, ...]] = {}  # by channel
        self._joiners = {robot: StepJoiner(robot, context=meter.context) for robot, meter in self.steps.items()}
        with self.pictures:
            messages = reader.messages(stamps=self.cameras.is_needed)  # stamps tell when a picture was taken
            for number, message in enumerate(messages):
                self._feed(message)
                if tell is not None and number % _TOLD_EACH == 0:
                    tell((message.log_ns - self.start_ns) * 1e-9)
        for robot, joiner in self._joiners.items():
            for step in joiner.finish():
                self._feed_step(robot, step)
        for blocks in self._blocks.values():
            blocks.flush()

    def _feed(self, message: Message) -> None:
        self.counter.feed(message)
        route = self._routes.get(message.channel.id)
        if route is None:
            route = self._routes[message.channel.id] = self._route(message.channel)
        for feed in route:
            feed(message)

    def _route(self, channel: Channel) -> tuple[Feed, ...]:
        """Return what takes the messages of a channel; each has been asked once, and not for every message."""
        topic, found = channel.topic, list[Feed]()
        if topic in self._camera_keys:
            found += [self.cameras.feed, self.pictures.feed]
        if topic == keys.NOT_MIRRORED or channel.is_deletion:
            found.append(self.changes.feed)
        if topic.startswith(keys.SERVER_PREFIX):
            found.append(self.heartbeats.feed)
        found += self._feeds.get(topic, ())
        found += [arm.feed for arm in self.arms if topic in arm.topics]
        if topic == keys.EVENT:
            found.append(self._feed_event)
        found += [partial(self._join, robot) for robot, joiner in self._joiners.items() if topic in joiner.topics]
        return tuple(found)

    def _join(self, robot: str, message: Message) -> None:
        step = self._joiners[robot].feed(message)
        if step is not None:
            self._feed_step(robot, step)

    def _feed_step(self, robot: str, step: Step) -> None:
        gate = self.steps[robot].feed(step)
        heard = self.steps[robot].heard
        self.alignment[robot].feed(step, gate, heard)
        self.plausibility[robot].feed_step(step, gate, heard)

    def _feed_event(self, message: Message) -> None:
        event = codec.parse_facts(message.data)
        self.events.append(((message.log_ns - self.start_ns) * 1e-9 - interruptions.late_s(event), event))
        if (end := pauses.end_of(message, event)) is not None and len(self.ends) < pauses.MOST_ENDS:
            self.ends.append(end)


@dataclass
class ChangeCounter:
    """Takes the messages of an episode and counts such changes by command and key.

    Attributes:
        start_ns: Instant that times are told from [ns since the epoch].
        contract: Tells what a key holds.
    """

    start_ns: int
    contract: Callable[[str], Contract | None]
    _found: dict[tuple[str, str], KeyChanges] = field(default_factory=dict)

    def feed(self, message: Message) -> None:
        """Add a message; any other is passed over."""
        if message.topic == keys.NOT_MIRRORED:
            said = not_mirrored.decode(message.data)
            if said is not None:
                self._count(said.command, said.key, said.count, message.log_ns)
        elif message.channel.is_deletion:
            self._count(DELETED, message.topic, 1, message.log_ns)

    def not_mirrored(self) -> list[KeyChanges]:
        """Return the writes that are not in the file, in the order of the first of each kind."""
        return [found for found in self._found.values() if found.command != DELETED]

    def deletions(self) -> list[KeyChanges]:
        """Return the deletions, likewise."""
        return [found for found in self._found.values() if found.command == DELETED]

    def _count(self, command: str, key: str, count: int, log_ns: int) -> None:
        known = self._found.get((command, key))
        if known is not None:
            self._found[command, key] = msgspec.structs.replace(known, count=known.count + count)
        elif len(self._found) < _MOST:
            known_as = self.contract(key.removesuffix("@"))
            at_s = round((log_ns - self.start_ns) * 1e-9, 3)
            self._found[command, key] = KeyChanges(
                command=command, key=key, count=count, at_s=at_s, role=known_as.role if known_as is not None else None
            )
