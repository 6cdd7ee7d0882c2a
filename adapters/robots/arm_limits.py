"""Limits of an arm's joints, from a file per model that names its source: a guessed limit must not become a default.

```yaml
model: kr810
source: where the numbers come from, so that they can be looked up
joints:                # from the base to the flange
  - {name: joint_1, lower_rad: -6.283, upper_rad: 6.283, speed_rad_s: 3.927, acceleration_rad_s2: 174.5}
  …
```
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from adapters.robots.kassow.names import ARM_7
from station import config
from station.description import Joint
from station.errors import ConfigError
from station.protocols import Floats

SHIPPED = Path(__file__).parent
"""Below it, in ``<maker>/<model>.yaml``, are the files that ship with the station."""

SOFT_MARGIN_RAD = math.radians(3.0)
"""How far inside a joint's limits commands end [rad]: a controller faults at its limit, and not before."""


class JointLimit(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of one joint.

    Attributes:
        name: As in `adapters.robots.kassow.names.ARM_7`.
        lower_rad, upper_rad: Range of its position [rad].
        speed_rad_s: Greatest speed [rad/s].
        acceleration_rad_s2: Greatest acceleration [rad/s2].
    """

    name: str
    lower_rad: float
    upper_rad: float
    speed_rad_s: float
    acceleration_rad_s2: float

    def __post_init__(self) -> None:
        numbers = (self.lower_rad, self.upper_rad, self.speed_rad_s, self.acceleration_rad_s2)
        if not all(map(math.isfinite, numbers)) or self.speed_rad_s <= 0 or self.acceleration_rad_s2 <= 0:
            raise ValueError(f"{self.name}: expected finite limits and a speed and an acceleration above 0")
        if not self.upper_rad - self.lower_rad > 2 * SOFT_MARGIN_RAD:
            raise ValueError(f"{self.name}: upper_rad {self.upper_rad} must be well above lower_rad {self.lower_rad}")


class LimitsFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file of limits: the model, where its numbers come from, and a limit per joint, from base to flange."""

    model: str
    source: str
    joints: tuple[JointLimit, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ArmLimits:
    """Limits of an arm of n joints; each array of shape (n,).

    Attributes:
        model: Which arm it is, for example ``kr810``.
        source: Where the numbers come from.
        file: What they were read from.
        joint_names: From the base to the flange.
        q_min, q_max: Ranges of the joints [rad]; never wrapped, a range may be wider than a turn.
        qd_max, qdd_max: Greatest speeds [rad/s] and accelerations [rad/s2].
    """

    model: str
    source: str
    file: Path
    joint_names: tuple[str, ...]
    q_min: Floats
    q_max: Floats
    qd_max: Floats
    qdd_max: Floats

    def joints(self) -> tuple[Joint, ...]:
        """Return the joints, as a description of the robot has them."""
        columns = (self.q_min.tolist(), self.q_max.tolist(), self.qd_max.tolist())
        return tuple(map(Joint, self.joint_names, *columns))

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of them."""
        arrays = {name: getattr(self, name).tolist() for name in ("q_min", "q_max", "qd_max", "qdd_max")}
        return {"model": self.model, "source": self.source, "file": str(self.file)} | arrays


def shipped(maker: str) -> Mapping[str, Path]:
    """Return the files of a maker's models that ship with the station, by model."""
    return {path.stem: path for path in sorted((SHIPPED / maker).glob("*.yaml"))}


def load(maker: str, model: str, file: Path | None = None) -> ArmLimits:
    """Return the limits of a model.

    Args:
        maker: Folder of the shipped files, for example ``kassow``.
        model: Which arm it is.
        file: The user's own file; None for the one that ships with the station.

    Raises:
        ConfigError: no file ships for the model, the file is for another one, or lacks a joint.
        BadFile: the file cannot be read.
    """
    known = shipped(maker)
    path = file or known.get(model)
    if path is None:
        raise ConfigError(
            f"model {model!r}: no limits of its joints ship with the station (only of {', '.join(known) or 'none'}); "
            "write those of its data sheet to a file, as docs/kassow.md shows, and name it with `limits`"
        )
    read = config.build(LimitsFile, config.read_yaml(path), where=str(path))
    if read.model != model:
        raise ConfigError(f"{path}: limits of model {read.model!r}, expected those of {model!r}")
    names = tuple(joint.name for joint in read.joints)
    if names != ARM_7:
        raise ConfigError(f"{path}: joints are {', '.join(names) or 'none'}; expected {', '.join(ARM_7)}")

    def column(field: str) -> Floats:
        values = np.array([getattr(joint, field) for joint in read.joints])
        values.flags.writeable = False
        return values

    return ArmLimits(
        model, read.source, path, names, column("lower_rad"), column("upper_rad"), column("speed_rad_s"),
        column("acceleration_rad_s2"),
    )  # fmt: skip
