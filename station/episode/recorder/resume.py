"""Taking an episode up again after its recorder was killed: the same file, the same clock, the same counts.

Beside an unfinished file stands how far it is safe and where the tap stood then. A new recorder goes on behind that
place in the server's stream of writes, and behind that byte of the file; what the dead one wrote after it comes once
more. Where the server no longer has what followed, every whole chunk is kept and the hole is written down. No step
changes anything that a second attempt, after another kill, would miss.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from station.bus import keys
from station.bus import stamp as stamps
from station.bus.clocks import OffsetOf, unknown
from station.clock import SYSTEM, Clock
from station.episode.recorder.active_episode import ActiveEpisode
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, iso, read_anchor
from station.episode.storage.left_open import remove_temporary
from station.episode.storage.manifest import Hole, Manifest, add_hole, add_recovery, facts_of
from station.episode.storage.manifest_copy import find_manifest
from station.episode.storage.progress import ResumePoint, Totals, load_resume_point
from station.episode.storage.records import metadata_at_head, parse_chunk, read_chunk, walk
from station.episode.storage.request import request_id
from station.episode.writing.files import EpisodeFiles
from station.episode.writing.summary import EpisodeSummary
from station.errors import EpisodeError

if TYPE_CHECKING:
    from station.bus.tap import Position, Write

_LONGEST_TIME = 19  # digits of nanoseconds
HOLE = "the recorder was killed, and the server no longer had what was written meanwhile"


class Unfinished(NamedTuple):
    """An episode that its recorder left open, and how far it is safe."""

    folder: Path
    point: ResumePoint
    manifest: Manifest

    def age_s(self, now_ns: int) -> float:
        """Return the time from its last flush to an instant [ns, monotonic] in [s]."""
        return (now_ns - self.point.mono_ns) * 1e-9


class ResumedEpisode(NamedTuple):
    """An episode that goes on.

    Attributes:
        take: The episode.
        requests: Ids of the requests that are done.
        awaited: Id of the start request that is to come once more; "" when the file holds it.
        written_ns: When the last write arrived that the file holds [ns, monotonic]; 0 when it holds none.
    """

    take: ActiveEpisode
    requests: list[str]
    awaited: str
    written_ns: int


def unfinished(folder: Path, bus: str) -> Unfinished | None:
    """Return an episode that was left open, if a recorder on this bus may take it up; None otherwise.

    It may when it was recorded from the same bus, in the same boot (its clock is the monotonic one), and was not given
    up for a full disk.
    """
    point = load_resume_point(folder)
    if point is None or point.anchor.boot != stamps.boot_id():
        return None
    try:
        manifest = find_manifest(folder).manifest
    except EpisodeError:
        return None
    if manifest.state != "recording" or manifest.recorder.bus not in ("", bus):
        return None
    return Unfinished(folder, point, manifest)


def reopen(
    found: Unfinished, options: RecordingOptions, *, place: Position | None, is_exact: bool, clock: Clock = SYSTEM
) -> ResumedEpisode:
    """Open an unfinished episode behind what is safe of it.

    Args:
        found: The episode.
        options: How to write.
        place: Where the tap stands.
        is_exact: Whether the tap goes on exactly where the episode is safe; else there is a hole.
        clock: The recorder's.

    Raises:
        EpisodeError: the file is damaged, or its manifest cannot be written.
        OSError: the disk refused it.
    """
    folder, point, manifest = found
    remove_temporary(folder)
    paths = [folder / names.active for names in layout.ALL_NAMES]
    size = sum(path.stat().st_size for path in paths if path.exists())
    files = None
    if point.size:
        files = EpisodeFiles.reopen(folder, facts_of(manifest), point, is_exact=is_exact)
    else:
        for path in paths:
            path.unlink(missing_ok=True)  # the head of the signals was not written yet, or not whole
    episode_summary, totals = (
        (files.signals.episode_summary, files.totals()) if files else (EpisodeSummary(point.anchor), Totals())
    )
    episode_summary.apply(manifest, totals.first_ns)
    _record_recovery(found, size, totals, from_ns=files.signals.last_log_ns if files else 0, is_exact=is_exact,
          now=read_anchor(clock))  # fmt: skip
    writer = EpisodeWriter(
        folder, anchor=point.anchor, manifest=manifest, options=options.writer, start_id=point.start_id, place=place,
        reopened=files, clock=clock,
    )  # fmt: skip
    is_awaited = is_exact and not point.messages
    take = ActiveEpisode(writer, manifest, start_id=point.start_id if not point.messages else None)
    written_ns = point.anchor.mono_ns + totals.last_ns - point.anchor.wall_ns if totals.last_ns else 0
    return ResumedEpisode(
        take, [*episode_summary.told.requests, point.start_id], point.start_id if is_awaited else "", written_ns
    )


def _record_recovery(found: Unfinished, size: int, kept: Totals, *, from_ns: int, is_exact: bool, now: Anchor) -> None:
    """Write into the manifest that the episode was taken up again, and how.

    A hole begins where the signals end, at `from_ns`: what was flushed of them last, no picture is missing before.
    """
    _, point, manifest = found
    now_s = (now.mono_ns - point.anchor.mono_ns) * 1e-9
    manifest.recorder.restarts += 1
    note = {
        "kind": "resumed",
        "at": iso(now.wall_ns),
        "at_s": round(now_s, 3),
        "away_s": round(found.age_s(now.mono_ns), 3),
        "by": "offset" if is_exact else "hole",
        "kept_messages": kept.messages,
        "kept_bytes": kept.bytes,
        "read_again_bytes" if is_exact else "cut_bytes": max(0, size - kept.bytes),
    }
    add_recovery(manifest, note)
    if not is_exact:
        last_s = (from_ns - point.anchor.wall_ns) * 1e-9 if from_ns else 0.0
        add_hole(manifest, Hole(from_s=round(last_s, 6), to_s=round(now_s, 6), reason=HOLE))


def newest_start_ns(data: Path) -> int:
    """Return when the last episode began that is closed and of this boot [ns, monotonic]; 0 where there is none."""
    clocks = (metadata_at_head(file, layout.ANCHOR_RECORD) for file in data.glob(f"*/*/{layout.SIGNALS}"))
    starts = (clock.get("mono_ns", "") for clock in clocks if clock.get("boot") == stamps.boot_id())
    return max((int(start) for start in starts if start.isdecimal() and len(start) <= _LONGEST_TIME), default=0)


def newest_closed(data: Path, now_wall_ns: int, within_s: float) -> Path | None:
    """Return the folder of the episode that was closed last, if that was not long ago; None otherwise."""
    found = max(((file.stat().st_mtime, file.parent) for file in data.glob(f"*/*/{layout.SIGNALS}")), default=None)
    return found[1] if found is not None and now_wall_ns * 1e-9 - found[0] < within_s else None


def last_requests(folder: Path) -> list[str]:
    """Return the ids of the requests to the recorder in the last chunk of a closed episode: what ended it is there.

    Raises:
        EpisodeError: it cannot be read.
        OSError: likewise.
    """
    file = folder / layout.SIGNALS
    contents = walk(file)
    channels, found = dict(contents.channels), []
    with file.open("rb") as stream:
        for place in contents.chunks[-1:]:
            for message in parse_chunk(read_chunk(stream, place), channels):
                if channels[message.channel_id].topic == keys.RECORD:
                    found.append(request_id(message.data))
    return [asker for asker in found if asker is not None]


def as_written(writes: Sequence[Write], after_ns: int, offset_of: OffsetOf) -> list[Write]:
    """Return writes that waited at the server, with the time at which they were written instead of when they came.

    A writer that stamps tells it, if its clock is known here; one that does not came right behind the write before it.
    So a recorder that was away leaves no burst behind, and no silence.

    Args:
        writes: In the order of the bus, with the time of their late arrival.
        after_ns: No time before this one [ns, monotonic]; 0 when nothing is known of what came before.
        offset_of: How the clocks of other machines are to be read.
    """
    told = [written_ns(write, offset_of) for write in writes]
    at_ns = after_ns or next((time_ns for time_ns in told if time_ns is not None), 0)
    dated = []
    for write, time_ns in zip(writes, told, strict=True):
        if time_ns is not None:
            at_ns = max(at_ns, min(time_ns, write.mono_ns))
        dated.append(write._replace(mono_ns=min(at_ns, write.mono_ns)) if at_ns else write)
    return dated


def written_ns(write: Write, offset_of: OffsetOf = unknown) -> int | None:
    """Return when a write was made [ns, monotonic]; None for a writer without stamps, or with a clock that is not known
    here."""
    mark = stamps.decode(write.stamp) if write.stamp is not None else None
    if mark is None or mark.is_from_this_boot:
        return None if mark is None else mark.mono_ns
    offset = offset_of(stamps.boot_of(mark.source))
    return None if offset is None else mark.mono_ns + offset.ns


def newest_written_ns(writes: Sequence[Write]) -> int:
    """Return when the newest of some writes was made that tells it [ns, monotonic]; 0 when none does.

    On the bus of another machine hardly one does: a stamp is read only where the name of this boot stands in it.
    """
    ours = f".{stamps.boot_id()}.".encode()
    told = (written_ns(write) for write in reversed(writes) if write.stamp is not None and ours in write.stamp)
    return next((time_ns for time_ns in told if time_ns is not None), 0)
