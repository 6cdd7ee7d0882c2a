"""Scripts of velocities, as YAML: what a robot on legs is asked for, one segment after the other.

```yaml
velocities:                            # in the heading frame of the base
  - {seconds: 4}                       # stands
  - {seconds: 8, vx: 0.5}              # forward [m/s]; vy is to the left
  - {seconds: 8, vx: 0.4, wz: -0.4}    # and turns right [rad/s]
  - {seconds: 4, height: 0.5}          # stands lower [m], where the command has a height
```
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import accumulate
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from station import config
from station.assets import sha256
from station.errors import UnknownName
from station.protocols import Motion, Reference

PREFIX = "velocity:"
_FOLDER = Path(__file__).parent / "scripts"
_RATE_HZ = 50.0
_HIGHEST_M = 2.0  # higher no robot stands
_FASTEST = 10.0  # [m/s], [rad/s]: beyond it a number is a mistake


class Segment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One velocity for a while.

    Attributes:
        seconds: For how long [s].
        vx, vy: Forward, to the left [m/s].
        wz: Turning left [rad/s].
        height: Of the base above the ground, of commands that have one [m]; 0 for that of standing.
    """

    seconds: float
    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0
    height: float = 0.0

    def __post_init__(self) -> None:
        if not 0.1 <= self.seconds <= 36_000.0:
            raise ValueError(f"seconds is {self.seconds:g}; expected 0.1 to 36000 s")
        for name in ("vx", "vy", "wz"):
            if not abs(value := getattr(self, name)) <= _FASTEST:
                raise ValueError(f"{name} is {value:g}; expected a velocity of at most {_FASTEST:g} m/s or rad/s")
        if not 0.0 <= self.height <= _HIGHEST_M:
            raise ValueError(
                f"height is {self.height:g}; expected a height of the base up to {_HIGHEST_M:g} m, or 0 for standing"
            )


class VelocityScript(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file: its segments, one after the other."""

    velocities: tuple[Segment, ...]

    def __post_init__(self) -> None:
        if not self.velocities:
            raise ValueError("velocities is empty; expected a segment, such as {seconds: 4, vx: 0.5}")


class Velocities:
    """A script as a motion without joints (`station.protocols.Motion`); its place is not known."""

    joint_names: tuple[str, ...] = ()
    fps = _RATE_HZ

    def __init__(self, script: VelocityScript, name: str, facts: dict[str, Any]) -> None:
        self.name, self._facts, self._segments = name, facts, script.velocities
        self._ends_s = list(accumulate(segment.seconds for segment in self._segments))

    @property
    def duration_s(self) -> float:
        """Time of all segments [s]."""
        return self._ends_s[-1]

    def at(self, time_s: float) -> Reference:
        """Return what is asked for at a time [s]: the velocity of the segment that begins or goes on then."""
        segment = self._segments[min(bisect_right(self._ends_s, time_s), len(self._segments) - 1)]
        return Reference(
            root_pos=np.array([0.0, 0.0, segment.height]), root_quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]), q=np.zeros(0),
            root_lin_vel=np.array([segment.vx, segment.vy, 0.0]), root_ang_vel=np.array([0.0, 0.0, segment.wz]),
        )  # fmt: skip

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this motion."""
        return dict(self._facts)


def names() -> list[str]:
    """Return the names of the scripts that are built in."""
    return sorted(path.stem for path in _FOLDER.glob("*.velocity"))


def is_named(reference: str) -> bool:
    """Whether a reference names a script that is built in."""
    return reference.startswith(PREFIX)


def path_of(reference: str) -> Path:
    """Return the file of the script that ``velocity:NAME`` names.

    Raises:
        UnknownName: there is none of that name.
    """
    if (name := reference.removeprefix(PREFIX)) not in names():
        raise UnknownName("script of velocities", name, names())
    return _FOLDER / f"{name}.velocity"


def script(reference: str) -> Motion:
    """Return the motion that ``velocity:NAME`` names.

    Raises:
        UnknownName: there is none of that name.
    """
    return load(path_of(reference))


def load(path: Path, *, fps: float | None = None) -> Motion:
    """Read a script; it has no frames, so `fps` changes nothing.

    Raises:
        BadFile: it cannot be read.
        ConfigError: it is no such script.
    """
    read = config.build(VelocityScript, config.read_yaml(path), where=str(path))
    seconds = sum(segment.seconds for segment in read.velocities)
    facts = {
        "file": str(path), "sha256": sha256(path), "format": "velocities", "fps": _RATE_HZ, "duration_s": seconds,
        "segments": msgspec.to_builtins(read.velocities),
    }  # fmt: skip
    return Velocities(read, path.stem, facts)
