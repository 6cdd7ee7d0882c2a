"""From a file, by whatever reader its suffix is registered under, to a captured person in our world."""

from __future__ import annotations

from pathlib import Path

from adapters.captures.captured import Captured, placed
from adapters.captures.joints import Joints
from station import registry
from station.errors import BadFile
from station.retargeting import Unit


def load(path: Path, *, units: Unit | None = None, height_m: float | None = None) -> Captured:
    """Read a capture.

    Args:
        path: The file.
        units: Of its lengths, in place of what it says, or of a guess.
        height_m: How tall the person is [m]; the file is scaled so.

    Raises:
        BadFile: missing, torn, too large, of no kind that is known, or no person.
        StationError: the library that reads it is not installed.
    """
    suffix, known = path.suffix.lower().removeprefix("."), registry.names("capture")
    if suffix not in known:
        listed = ", ".join(f".{name}" for name in known)
        raise BadFile(f"{path}: no reader of captures for {path.suffix or 'a name without a suffix'}; known: {listed}")
    joints: Joints = registry.find("capture", suffix)(path, height_m=height_m)
    return placed(joints, units=units, height_m=height_m)
