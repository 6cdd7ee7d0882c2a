"""From a file, by whatever reader its suffix is registered under, to a clip that a robot may follow."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from adapters.motions import builtin
from adapters.motions.bad_frames import Holes, mend
from adapters.motions.clip import Clip
from adapters.motions.raw import RawMotion
from station import assets, registry
from station.errors import BadFile

log = logging.getLogger(__name__)


def load(reference: str | os.PathLike[str], *, holes: Holes = "refuse", fps: float | None = None) -> Clip:
    """Read a motion, trim or bridge its bad frames, and make it a clip.

    Args:
        reference: A path, ``collection:path`` below ``$STATION_ASSETS``, or ``builtin:NAME``.
        holes: What is done with bad frames between good ones: ``refuse`` or ``bridge``.
        fps: Frames per second, in place of what the file says (a ``.csv`` says nothing: 30).

    Raises:
        BadFile: missing, torn, malicious, of the wrong shape, or with frames that cannot be used.
        AssetMissing: the reference needs upstream data that is not there.
    """
    raw = builtin.make(os.fspath(reference)) if builtin.is_named(os.fspath(reference)) else _read(reference, fps)
    good, report = mend(raw, holes=holes)
    for line in report.lines():
        log.warning("%s: %s", raw.path.name, line)
    facts = {
        "file": os.fspath(reference) if not isinstance(reference, Path) else str(reference),
        "sha256": builtin.sha256(raw) if raw.format == builtin.FORMAT else assets.sha256(raw.path),
        "format": raw.format,
        "fps": raw.fps,
        "duration_s": (len(good) - 1) / good.fps,
        "holes": holes,
        "joints_filled_with_zero": list(raw.filled),
        **report.facts(),
    }
    return Clip(good, facts=facts)


def _read(reference: str | os.PathLike[str], fps: float | None) -> RawMotion:
    path = assets.resolve(reference)
    suffix = path.suffix.lower().removeprefix(".")
    readers = registry.names("motion")
    if suffix not in readers:
        known = ", ".join(f".{name}" for name in readers)
        raise BadFile(
            f"{path}: no reader for {repr(path.suffix) if path.suffix else 'a name without a suffix'}; known: {known}"
        )
    raw: RawMotion = registry.find("motion", suffix)(path, fps=fps)
    return raw
