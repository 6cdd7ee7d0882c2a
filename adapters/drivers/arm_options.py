"""Options of the drivers of an arm, `arm-joints` and `arm-tcp`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import msgspec

from station import registry
from station.operator.sample import Side

Corner = tuple[float, float, float]


class ArmOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is driven, and how fast.

    Attributes:
        model: Which arm, for example ``kr810``.
        name: Further part of the suffix of its keys, for a second arm of the model; "" for none.
        limits: File with the limits of its joints; None for the one that ships with the station.
        command: Registered format of the positions of an arm's joints, in place of the three above; it has limits.
        robot: End of the keys of the robot's part that takes that command, where it is not the command's own:
            ``g1_dex3_left_arm``.
        speed_rad_s: Greatest speed of a joint [rad/s]; the arm's own profile must be as fast.
        tool_mps, tool_rad_s: Speeds of the tool at full deflection, and the greatest ones [m/s, rad/s].
        box_lower, box_upper: Corners that the tool stays between, in the frame of the base [m].
        tip: What moves and is turned about, in the frame of the flange [m]; the flange itself, or the tip of a tool.
        facing_rad: Where the operator faces, seen from the arm's base [rad]: 0 looks along its x, pi looks at it from
            in front.
        frame: Along whose axes a twist or keys move the tool: the base's as the operator faces it, or the tool's own.
        hand: The hand that the tool follows.
        scale: How far the tool goes for each metre of that hand.
        heading: What is forward for a hand: ``world``, where the operator faced when the device was centred, or
            ``head``, where the headset faces at engaging.
    """

    model: str = "kr810"
    name: str = ""
    limits: Path | None = None
    command: str = ""
    robot: str = ""
    speed_rad_s: float = 0.3
    tool_mps: float = 0.15
    tool_rad_s: float = 0.5
    box_lower: Corner = (-1.0, -1.0, 0.0)
    box_upper: Corner = (1.0, 1.0, 1.5)
    tip: Corner = (0.0, 0.0, 0.0)
    facing_rad: float = 0.0
    frame: Literal["base", "tool"] = "base"
    hand: Side = "right"
    scale: float = 1.0
    heading: Literal["world", "head"] = "world"

    def __post_init__(self) -> None:
        if self.command:
            registry.expect("command", self.command)
        elif self.robot:
            raise ValueError(
                f"robot is {self.robot!r}; expected none without a command: an arm's is its model and name"
            )
        for name, most in (("speed_rad_s", 4.0), ("tool_mps", 1.0), ("tool_rad_s", 3.0)):
            if not 0.01 <= getattr(self, name) <= most:
                raise ValueError(f"{name} is {getattr(self, name):g}; expected 0.01 to {most:g}")
        if not 0.1 <= self.scale <= 3.0:
            raise ValueError(f"scale is {self.scale:g}; expected 0.1 to 3")
        if not abs(self.facing_rad) <= 2.0 * math.pi:
            raise ValueError(f"facing_rad is {self.facing_rad:g}; expected a direction in radians, -2 pi to 2 pi")
        if not all(lower < upper for lower, upper in zip(self.box_lower, self.box_upper, strict=True)):
            raise ValueError(f"box_upper is {list(self.box_upper)}; expected more than box_lower in x, y and z")
