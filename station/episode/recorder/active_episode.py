"""One episode in the making: its writer, and the manifest that grows beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from station.bus import keys
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import iso
from station.episode.storage.left_out import LeftOut
from station.episode.storage.manifest import Hole, Manifest, add_hole
from station.episode.storage.progress import Totals
from station.episode.storage.request import RecordAnswer, RecorderState
from station.episode.writing.closing import close_manifest
from station.episode.writing.servers_seen import add_motion, is_motion
from station.episode.writing.summary import add_event, add_mark, count_not_mirrored

if TYPE_CHECKING:
    from station.bus.tap import Position, Write

_SAVE_EVERY_S = 1.0


class ActiveEpisode:
    """From the start request to the closed file. Belongs to one thread; the writer's own thread does the work.

    Args:
        writer: Writes the file.
        manifest: What is known so far.
        start_id: Id of the request that is to be answered once the file is open; None when there is none.

    Attributes:
        folder, anchor: Folder of the episode, and its clock, whose instant is the start.
        start_id: As above; None when it has been answered.
        end_ids, discard_ids: Ids of those that are to be answered once the file is closed.
    """

    def __init__(self, writer: EpisodeWriter, manifest: Manifest, *, start_id: str | None = None) -> None:
        self.writer = writer
        self.folder = writer.folder
        self.anchor = writer.anchor
        self.manifest = manifest
        self.start_id = start_id
        self.end_ids: list[str] = []
        self.discard_ids: list[str] = []
        self._is_dirty = False
        self._clock, self._left_out = writer.clock, LeftOut(manifest.recorder.leave_out)
        self._saved_at = self._clock.monotonic_s()

    @property
    def episode_id(self) -> str:
        """The episode's id."""
        return self.manifest.episode_id

    def begin(self, preroll: Sequence[Write]) -> None:
        """Put in what came before the start."""
        if preroll and not self.manifest.timing.preroll_s:
            self.manifest.timing.preroll_s = max(0.0, -self._at_s(preroll[0].mono_ns))
        for write in preroll:
            self.add_to_manifest(write)
        self.writer.put(self._left_out.without(preroll), is_live=False, is_whole=False, is_held=True)

    def put(
        self, writes: Sequence[Write], position: Position | None, *, is_whole: bool = True, is_live: bool = True
    ) -> int:
        """Put in what arrived, as `EpisodeWriter.put`; return how many writes had to be dropped."""
        kept = self._left_out.without(writes)
        return self.writer.put(kept, position=position, is_whole=is_whole, is_live=is_live)

    def add_to_manifest(self, write: Write) -> None:
        """Add to the manifest what belongs there of an event, a command's source, or a message of the tap."""
        if write.value is None:
            return
        if write.key == keys.EVENT:
            add_event(self.manifest, write.value, self._at_s(write.mono_ns))
            self._is_dirty = True
        elif write.key == keys.NOT_MIRRORED:
            count_not_mirrored(self.manifest.recorder, write.value)
            self._is_dirty = True
        elif is_motion(write.key):
            self._is_dirty |= add_motion(self.manifest, write.key, write.value)

    def mark(self, label: str, mono_ns: int, success: bool | None) -> bool:
        """Mark an instant; False when there are too many marks already."""
        is_noted = add_mark(self.manifest, label, self._at_s(mono_ns), success)
        self._is_dirty |= is_noted
        return is_noted

    def hole(self, from_ns: int, to_ns: int, reason: str) -> None:
        """Record that writes between two instants [ns, monotonic] may be missing."""
        add_hole(self.manifest, Hole(from_s=self._at_s(from_ns), to_s=self._at_s(to_ns), reason=reason))
        self.writer.save_manifest(self.manifest)  # the file does not tell of it: safe before what follows

    def touch(self) -> None:
        """Have the manifest saved soon: it was changed."""
        self._is_dirty = True

    def save_if_due(self) -> None:
        """Have a changed manifest written to disk, at most once a second."""
        now = self._clock.monotonic_s()
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
        """Return what a recorder with this episode is doing."""
        writer = self.writer
        return RecorderState(
            state="recording", episode_id=self.episode_id, path=str(self.folder), messages=writer.messages,
            bytes=writer.size, dropped=writer.dropped + writer.refused, queued=writer.queued, backend=backend,
            lag_ms=writer.lag.percentile_ms(50), lag_p99_ms=writer.lag.percentile_ms(99), error=writer.error,
            restarts=self.manifest.recorder.restarts,
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
            "holes": len(self.manifest.holes) + self.manifest.holes_not_listed,
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
        close_manifest(self.manifest, self.anchor, totals)
        return self.manifest

    def _at_s(self, mono_ns: int) -> float:
        return round((mono_ns - self.anchor.mono_ns) * 1e-9, 6)
