"""One episode in the making: its writer, and the manifest that grows beside it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.bus import keys
from station.episode import manifest as manifests
from station.episode.anchor import Anchor
from station.episode.heard import is_motion, json_object, note_motion
from station.episode.manifest import Event, Hole, Manifest, Mark
from station.episode.progress import Totals, WriterOptions
from station.episode.request import RecordAnswer, RecorderState
from station.episode.writer import EpisodeWriter

if TYPE_CHECKING:
    from station.bus.tap import Position, Write

_SAVE_EVERY_S = 1.0
_LONGEST_EVENT = 8192  # bytes; a longer one stands in the signals, the manifest says how long
_EVENT_FIELDS = ("name", "severity", "source", "wall_ns", "detail")


class Take:
    """From the start request to the closed file. Belongs to one thread; the writer's own thread does the work.

    Args:
        folder: Folder of the episode, already made.
        anchor: Clock of the episode; its instant is the start.
        manifest: What is known before the first message.
        start_id: Id of the request that is to be answered once the file is open.
        options: How to write.

    Attributes:
        start_id: Id of the request that is to be answered once the file is open; None when it has been.
        end_ids, discard_ids: Ids of those that are to be answered once the file is closed.
        has_dropped: Whether a full queue has been complained about.
    """

    def __init__(
        self, folder: Path, anchor: Anchor, manifest: Manifest, *, start_id: str, options: WriterOptions
    ) -> None:
        self.folder = folder
        self.anchor = anchor
        self.manifest = manifest
        self.start_id: str | None = start_id
        self.end_ids: list[str] = []
        self.discard_ids: list[str] = []
        self.has_dropped = False
        self.writer = EpisodeWriter(folder, anchor=anchor, manifest=manifest, options=options)
        self._is_dirty = False
        self._saved_at = time.monotonic()

    @property
    def episode_id(self) -> str:
        """The episode's id."""
        return self.manifest.episode_id

    def begin(self, preroll: Sequence[Write]) -> None:
        """Put in what came before the start."""
        if preroll:
            self.manifest.timing.preroll_s = round((self.anchor.mono_ns - preroll[0].mono_ns) * 1e-9, 6)
        for write in preroll:
            self.note(write)
        self.writer.put(preroll, is_live=False)

    def put(self, writes: Sequence[Write], position: Position | None) -> int:
        """Put in what arrived; return how many writes had to be dropped."""
        return self.writer.put(writes, position=position) if writes else 0

    def note(self, write: Write) -> None:
        """Take from an event or a command's source what belongs into the manifest."""
        if write.value is None:
            return
        if write.key == keys.EVENT:
            self._note_event(write.value, write.mono_ns)
        elif is_motion(write.key):
            self._is_dirty |= note_motion(self.manifest, write.key, write.value)

    def mark(self, label: str, mono_ns: int, success: bool | None) -> bool:
        """Mark an instant; False when there are too many marks already."""
        if len(self.manifest.marks) >= manifests.MAX_MARKS:
            return False
        self.manifest.marks.append(Mark(at_s=self._at_s(mono_ns), label=label))
        if success is not None:
            self.manifest.quality_flags.success = success
        self._is_dirty = True
        return True

    def hole(self, from_ns: int, to_ns: int, reason: str) -> None:
        """Note that writes between two instants [ns, monotonic] may be missing."""
        self.manifest.holes.append(Hole(from_s=self._at_s(from_ns), to_s=self._at_s(to_ns), reason=reason))
        self._is_dirty = True

    def touch(self) -> None:
        """Have the manifest saved soon: somebody changed it."""
        self._is_dirty = True

    def save_if_due(self) -> None:
        """Have a changed manifest written to disk, at most once a second."""
        now = time.monotonic()
        if self._is_dirty and now - self._saved_at >= _SAVE_EVERY_S:
            self.writer.save_manifest(self.manifest)
            self._is_dirty, self._saved_at = False, now

    def finish(self, ended_by: str, mono_ns: int) -> None:
        """Close the episode; `is_over` tells when that is done. Nothing else may be called in between."""
        self.manifest.recorder.ended_by = ended_by
        self.manifest.timing.duration_s = round((mono_ns - self.anchor.mono_ns) * 1e-9, 6)
        self.manifest.timing.ended = iso(self.anchor.at(mono_ns))
        self.writer.finish(self._closed)

    @property
    def is_over(self) -> bool:
        """Whether the file is closed, or given up."""
        return self.writer.wait(0.0)

    def state(self, backend: str) -> RecorderState:
        """Return what a recorder with this take is doing."""
        writer = self.writer
        return RecorderState(
            state="recording", episode_id=self.episode_id, path=str(self.folder), messages=writer.messages,
            bytes=writer.size, dropped=writer.dropped, queued=writer.queued, backend=backend,
            lag_ms=writer.lag.percentile_ms(50), lag_p99_ms=writer.lag.percentile_ms(99), error=writer.error,
        )  # fmt: skip

    def summary(self) -> dict[str, Any]:
        """Return what an operator wants to hear at the end, from the counters of the file."""
        totals = self.writer.totals()
        flags = self.manifest.quality_flags
        return {
            "seconds": self.manifest.timing.duration_s,
            "preroll_s": self.manifest.timing.preroll_s,
            "messages": totals.messages,
            "bytes": totals.bytes,
            "streams": len(totals.streams),
            "foreign_streams": sum(not stream.source for stream in totals.streams),
            "lost": sum(stream.lost for stream in totals.streams),
            "dropped": totals.dropped,
            "holes": len(self.manifest.holes),
            "events": len(self.manifest.events) + self.manifest.events_not_listed,
            "falls": flags.falls,
            "success": flags.success,
            "discarded": flags.discarded,
            "lag_p50_ms": totals.lag_p50_ms,
            "lag_p99_ms": totals.lag_p99_ms,
        }

    def answer(self, asker: str, *, reason: str = "") -> RecordAnswer:
        """Return an answer about this episode; a reason makes it a refusal."""
        path = str(self.folder)
        return RecordAnswer(id=asker, ok=not reason, episode_id=self.episode_id, path=path, reason=reason)

    def _closed(self, totals: Totals) -> Manifest:
        manifest = self.manifest
        manifest.state = "finished"
        manifest.streams = totals.streams
        recorder = manifest.recorder
        recorder.messages, recorder.bytes, recorder.dropped = totals.messages, totals.bytes, totals.dropped
        recorder.lag_p50_ms, recorder.lag_p99_ms = totals.lag_p50_ms, totals.lag_p99_ms
        return manifest

    def _note_event(self, value: bytes, mono_ns: int) -> None:
        facts = json_object(value) or {"name": "undecodable", "severity": "warning"}
        event = Event(
            at_s=self._at_s(mono_ns),
            name=str(facts.get("name", "unnamed")),
            severity=str(facts.get("severity", "info")),
            source=str(facts.get("source", "")),
            numbers=_numbers(facts) if len(value) <= _LONGEST_EVENT else {"bytes": len(value)},
        )
        if mono_ns >= self.anchor.mono_ns:
            flags = self.manifest.quality_flags
            flags.falls += event.name == "fall"
            flags.operator_reset |= event.name == "operator-reset"
            flags.estop |= event.name == "estop"
        if len(self.manifest.events) < manifests.MAX_EVENTS:
            self.manifest.events.append(event)
        else:
            self.manifest.events_not_listed += 1
        self._is_dirty = True

    def _at_s(self, mono_ns: int) -> float:
        return round((mono_ns - self.anchor.mono_ns) * 1e-9, 6)


def iso(wall_ns: int) -> str:
    """Return a wall time [ns since the epoch] as ISO 8601 with milliseconds and the local offset."""
    return datetime.fromtimestamp(wall_ns * 1e-9).astimezone().isoformat(timespec="milliseconds")


def _numbers(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the detail of an event, and whatever a foreign writer put beside it."""
    beside = {name: value for name, value in facts.items() if name not in _EVENT_FIELDS}
    detail = facts.get("detail", {})
    return {**beside, **(detail if isinstance(detail, dict) else {"detail": detail})}
