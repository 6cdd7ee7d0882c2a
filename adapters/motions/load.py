"""From a file, by whatever reader its suffix is registered under, to a clip that a robot may follow.

A reference may end in what is to be done to the motion: ``#mirror`` (left becomes right), ``#speed=1.2`` (that much
faster), ``#retarget=1.75`` (as a person of 1.75 m does it, tracked and retargeted frame by frame), or several, as
``#mirror#speed=1.2``. So a changed motion can be named wherever a motion can, and a manifest that names it says how it
came about.
"""

from __future__ import annotations

import logging
import os
import re
from pathlib import Path

from adapters.motions import builtin, velocities
from adapters.motions.bad_frames import Holes, mend
from adapters.motions.clip import Clip
from adapters.motions.raw import RawMotion
from adapters.motions.transforms import mirrored, retimed
from station import assets, registry
from station.errors import BadFile, UsageError
from station.protocols import Motion

log = logging.getLogger(__name__)

_CHANGES = re.compile(r"(#(mirror|(speed|retarget)=[^/#]*))+$")  # any other "#" belongs to the name of a file


def load(reference: str | os.PathLike[str], *, holes: Holes = "refuse", fps: float | None = None) -> Motion:
    """Read a motion, trim or bridge its bad frames, make it a clip, and change it as its reference says.

    Args:
        reference: A path, ``collection:path`` below ``$STATION_ASSETS``, ``builtin:NAME`` or ``velocity:NAME``; changes
            may follow.
        holes: What is done with bad frames between good ones: ``refuse`` or ``bridge``.
        fps: Frames per second, in place of what the file says (a ``.csv`` says nothing: 30).

    Raises:
        BadFile: missing, torn, malicious, of the wrong shape, or with frames that cannot be used.
        UsageError: a change that cannot be.
        AssetMissing: the reference needs upstream data that is not there.
    """
    text = os.fspath(reference)
    found = _CHANGES.search(text)
    plain = text[: found.start()] if found else text
    motion = velocities.script(plain) if velocities.is_named(plain) else _read(plain, holes, fps)
    for change in found[0][1:].split("#") if found else ():
        motion = _changed(motion, change)
    return motion


def expect(reference: str | os.PathLike[str]) -> None:
    """Check, without reading it, that a motion is there and has a reader.

    Raises:
        BadFile, UnknownName, AssetMissing: it is not, or has none.
    """
    plain = _CHANGES.sub("", os.fspath(reference))
    if builtin.is_named(plain):
        builtin.expect(plain)
    elif velocities.is_named(plain):
        velocities.path_of(plain)
    else:
        _reader_of(assets.resolve(plain))


def _read(plain: str, holes: Holes, fps: float | None) -> Motion:
    if builtin.is_named(plain):
        return _clip(plain, builtin.make(plain), holes)
    path = assets.resolve(plain)
    found: RawMotion | Motion = registry.find("motion", _reader_of(path))(path, fps=fps)
    return _clip(plain, found, holes) if isinstance(found, RawMotion) else found


def _clip(plain: str, raw: RawMotion, holes: Holes) -> Clip:
    good, report = mend(raw, holes=holes)
    for line in report.lines():
        log.warning("%s: %s", raw.path.name, line)
    facts = {
        "file": plain,
        "sha256": builtin.sha256(raw) if raw.format == builtin.FORMAT else assets.sha256(raw.path),
        "format": raw.format,
        "fps": raw.fps,
        "duration_s": (len(good) - 1) / good.fps,
        "holes": holes,
        "joints_filled_with_zero": list(raw.filled),
        **report.facts(),
        **({"provenance": dict(raw.provenance)} if raw.provenance else {}),
        **(builtin.facts(plain) if raw.format == builtin.FORMAT else {}),
    }
    return Clip(good, facts=facts)


def _changed(motion: Motion, change: str) -> Motion:
    if change == "mirror":
        return mirrored(motion)
    what, _, text = change.partition("=")
    try:
        value = float(text)
    except ValueError:
        example = {"speed": "1.2", "retarget": "1.75, the height of a person in metres"}[what]
        raise UsageError(
            f"{motion.name}#{change}: {what} is {text!r}; expected a number, for example {example}"
        ) from None
    if what == "retarget":
        if not motion.joint_names:
            raise UsageError(
                f"{motion.name}#{change}: it says velocities and no joints, which is all that a person shows"
            )
        from adapters.retarget.played import imitated

        return imitated(motion, value)
    return retimed(motion, value)


def _reader_of(path: Path) -> str:
    """Return the name of what reads a file, by its suffix."""
    suffix = path.suffix.lower().removeprefix(".")
    readers = registry.names("motion")
    if suffix not in readers:
        known = ", ".join(f".{name}" for name in readers)
        raise BadFile(
            f"{path}: no reader for {repr(path.suffix) if path.suffix else 'a name without a suffix'}; known: {known}"
        )
    return suffix
