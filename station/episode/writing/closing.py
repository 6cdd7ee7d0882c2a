"""The last words of an episode: its counters put into its manifest, its holes measured, its summary."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec

from station.episode.storage import pictures
from station.episode.storage.anchor import Anchor
from station.episode.storage.file_hashes import measure
from station.episode.storage.manifest import MAX_STREAMS, Manifest
from station.episode.storage.progress import Gap, Totals


def measure_holes(manifest: Manifest, anchor: Anchor, gaps: list[Gap]) -> None:
    """Put into each hole how many writes are missing there, by the sequence numbers of their writers."""
    spans = [
        (anchor.wall_ns + hole.from_s * 1e9, anchor.wall_ns + (math.inf if hole.to_s is None else hole.to_s * 1e9))
        for hole in manifest.holes
    ]
    lost = [0] * len(spans)
    for gap in gaps:
        around = [n for n, (from_ns, to_ns) in enumerate(spans) if gap.before_ns <= to_ns and gap.after_ns >= from_ns]
        if around:
            lost[around[-1]] += gap.lost
    for hole, count in zip(manifest.holes, lost, strict=True):
        hole.lost = count


def close_manifest(manifest: Manifest, anchor: Anchor, totals: Totals) -> None:
    """Put the counters of the closed file into its manifest."""
    manifest.state = "finished"
    manifest.streams = totals.streams[:MAX_STREAMS]
    manifest.streams_not_listed = len(totals.streams) - len(manifest.streams)
    recorder = manifest.recorder
    recorder.messages, recorder.bytes, recorder.dropped = totals.messages, totals.bytes, totals.dropped
    recorder.lag_p50_ms, recorder.lag_p99_ms = totals.lag_p50_ms, totals.lag_p99_ms
    measure_holes(manifest, anchor, totals.gaps)
    manifest.cameras = manifest.cameras or _cameras(manifest)


def _cameras(manifest: Manifest) -> list[dict[str, Any]]:
    """Return whose pictures there are: name, key, how many, and what their servers state of each."""
    counts = Counter[str]()
    for stream in manifest.streams:
        counts[stream.key] += stream.count if pictures.is_picture(stream.key) else 0
    stated = {str(one.get("key")): one for facts in manifest.servers.values() for one in pictures.stated(facts)}
    return [
        {"name": pictures.camera_of(key), "key": key, "pictures": count}
        | {name: stated[key][name] for name in _said(key) if name in stated.get(key, {})}
        for key, count in sorted(counts.items())
        if count
    ]


def _said(key: str) -> tuple[str, ...]:
    """Return what is named of a camera, where it is stated: size [px] and rate [Hz]; of depth also what it needs."""
    size = ("width", "height", "fps")
    return (*size, "step_m", "range_m", "is_aligned", "intrinsics") if pictures.is_depth(key) else size


def note_files(manifest: Manifest, folder: Path) -> None:
    """Put into the manifest of an episode what tells its closed files from all others.

    Raises:
        OSError: one cannot be read.
    """
    manifest.files = measure(folder)
    manifest.recorder.bytes = sum(file.bytes for file in manifest.files)


def summary_record(totals: Totals) -> dict[str, str]:
    """Return the counters as the file's own summary has them."""
    return {
        "messages": str(totals.messages),
        "dropped": str(totals.dropped),
        "lost": str(sum(stream.lost for stream in totals.streams)),
        "streams": msgspec.json.encode(totals.streams).decode(),
    }


def summary_of(manifest: Manifest) -> dict[str, Any]:
    """Return what an operator wants to hear of a closed episode."""
    recorder, flags = manifest.recorder, manifest.quality_flags
    return {
        "seconds": manifest.timing.duration_s,
        "preroll_s": manifest.timing.preroll_s,
        "messages": recorder.messages,
        "bytes": recorder.bytes,
        "streams": len(manifest.streams) + manifest.streams_not_listed,
        "foreign_streams": sum(not stream.source for stream in manifest.streams),
        "lost": sum(stream.lost for stream in manifest.streams),
        "dropped": recorder.dropped,
        "holes": len(manifest.holes) + manifest.holes_not_listed,
        "events": len(manifest.events) + manifest.events_not_listed,
        "falls": flags.falls,
        "success": flags.success,
        "discarded": flags.discarded,
        "lag_p50_ms": recorder.lag_p50_ms,
        "lag_p99_ms": recorder.lag_p99_ms,
    }
