"""The drivers `arm-joints` and `arm-tcp`: an arm, joint by joint or by its tool.

Both are one driver that begins in another mode; the mode button goes from the joints near the base to those of the
wrist to the tool. What is asked for is a running target of the joints, absolute and never wrapped: it moves by what the
operator asks in a tick, within soft limits and no faster than told, and stands where it is when he lets go.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import msgspec
import numpy as np

from adapters.commands.arm import arm_command
from adapters.drivers import arm_input
from adapters.drivers.arm_input import ArmInput, Choice
from adapters.drivers.arm_options import ArmOptions
from adapters.drivers.arm_tool import ArmTool
from adapters.robots import arm_limits
from adapters.robots.kassow import kinematics
from adapters.robots.kassow.names import MAKER, suffix
from station import registry, rotations
from station.arms import JointCommand
from station.errors import ConfigError
from station.operator import deltas
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample, Pose
from station.parts import PartedCommand
from station.protocols import CommandFormat, Floats

TOOL = "tool"

APART_RAD = 0.8
"""A leader farther from the arm may not begin to drive it; as in GELLO [rad]."""

_LIMITS = ("lower", "upper", "margin", "rate")

_TURNED_BY_TWIST = {
    0: (5, 1.0), 1: (0, 1.0), 2: (3, 1.0), 3: (2, -1.0), 4: (3, 1.0), 5: (4, 1.0), 6: (5, 1.0),
}  # fmt: skip
"""Which joint is turned by which axis of a twist vx vy vz wx wy wz, and which way: the cap turned turns the
base, pushed forwards it leans the arm forwards, tilted sideways it rolls the upper arm, lifted it lifts the forearm; at
the wrist tilting and turning do what they do to the cap."""


@dataclass(frozen=True, slots=True, eq=False)
class _Anchor:
    """From where movements are counted: since driving or the mode began.

    Attributes:
        snapshot: The dead-man's.
        mode: What moves.
        poses: The operator's hand, and head.
        tool: Where the tool was.
    """

    snapshot: Snapshot[ArmInput, Floats]
    mode: str
    poses: Mapping[str, Pose]
    tool: Pose | None


class ArmDriver:
    """Implements `station.operator.driver.Driver`.

    Args:
        name: Registered name.
        options: What is driven, and how fast.
        begins: Whether it begins with the joints or with the tool.

    Raises:
        ConfigError: no limits of the model are known, it is slower than asked for, or it begins with the tool of an
            arm whose kinematics are not known.
        BadFile: the file of limits cannot be read.
    """

    def __init__(self, name: str, options: ArmOptions, begins: Literal["joints", "tool"]) -> None:
        self.name, self._options = name, options
        self._command_format, self._limits = _command_format(options)
        self._joints = [element.name.removesuffix("_pos") for element in self._command_format.elements]
        if options.command and begins == "tool":
            raise ConfigError(f"the kinematics behind {options.command!r} are not known; take the driver arm-joints")
        is_known = not options.command and options.model in kinematics.MODELS
        self._tool = _tool(options) if begins == "tool" or is_known else None
        self._parts = _parts(len(self._joints))
        self._modes = (*self._parts, TOOL) if self._tool is not None else (*self._parts,)
        self._mode = TOOL if begins == "tool" else self._modes[0]
        self._choice = Choice(len(self._joints))
        self._anchor: _Anchor | None = None
        self._q: Floats = np.array(self._command_format.default)
        self._lower, self._upper = self._command_format.lower, self._command_format.upper

    @property
    def command_format(self) -> CommandFormat:
        """Positions of the joints."""
        return self._command_format

    @property
    def mode(self) -> str:
        """What moves: ``joints 1-4``, ``joints 5-7`` (of an arm of seven) or the ``tool``."""
        return self._mode

    @property
    def target(self) -> Floats:
        """Joints that are asked for, shape (n,) [rad]."""
        return self._q.copy()

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Nothing stands beside the command."""
        return self._command_format.auxiliary

    @property
    def is_still(self) -> bool:
        """The target stays where it is while the operator moves nothing."""
        return True

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """Require a leader, a tracked hand, a twist or controls; to begin, a leader must be near the arm."""
        found = self._input(sample)
        if isinstance(found, str):
            return DriverInput(None, found)
        if found.joints is None:
            return DriverInput(found)
        far = [
            f"{name} by {way:+.2f}"
            for name, way in zip(self._joints, (self._q - found.joints).tolist(), strict=True)
            if abs(way) > APART_RAD
        ]
        return DriverInput(
            found, why_not_engage=f"leader is too far from the arm; move it (rad): {', '.join(far)}" if far else ""
        )

    def jump(self, before: ArmInput, now: ArmInput) -> str:
        """Return what jumped, or ""; a device that drives by another part of its samples has lost the one before."""
        return arm_input.jump(before, now, self._joints)

    def next_mode(self) -> str:
        """Go on to the next mode; what moved before stays."""
        self._mode = self._modes[(self._modes.index(self._mode) + 1) % len(self._modes)]
        if self._mode != TOOL and self._choice.joint not in self._parts[self._mode]:
            self._choice.joint = self._parts[self._mode].start
        return self._mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot the target stands."""
        if sample is not None and self._mode != TOOL:
            self._choice.step(sample.controls)
            self._mode = next(mode for mode, part in self._parts.items() if self._choice.joint in part)
        anchor = self._anchor
        if snapshot is None or sample is None:
            self._anchor = None
        elif anchor is None or anchor.snapshot is not snapshot or anchor.mode != self._mode:
            self._anchor = self._anchored(snapshot, sample)  # the command of this tick is the one before it
        else:
            self._q = np.clip(self._moved(sample, anchor, dt_s), self._lower, self._upper)
        return self._q.copy()

    def resume_from(self, command: Floats) -> None:
        """Go on from where the arm stands; one that stands outside its soft limits may only come in."""
        self._q = np.array(command)
        self._lower = np.minimum(self._command_format.lower, self._q)
        self._upper = np.maximum(self._command_format.upper, self._q)

    def facts(self) -> dict[str, Any]:
        """Name, options, modes and limits."""
        options = msgspec.to_builtins(self._options, enc_hook=str)
        return {"driver": self.name, **options, "modes": list(self._modes), "limits": self._limits}

    def _input(self, sample: OperatorSample) -> ArmInput | str:
        needs_head = self._options.heading == "head"
        return arm_input.of(
            sample, self._options.hand, joints=len(self._joints), needs_head=needs_head, is_tool=self._mode == TOOL
        )

    def _anchored(self, snapshot: Snapshot[ArmInput, Floats], sample: OperatorSample) -> _Anchor:
        found, pose = self._input(sample), None
        if self._mode == TOOL and self._tool is not None:
            self._tool.rest(self._q)
            pose = self._tool.pose(self._q)
        poses = found.poses if isinstance(found, ArmInput) and found.poses is not None else {}
        return _Anchor(snapshot, self._mode, poses, pose)

    def _moved(self, sample: OperatorSample, anchor: _Anchor, dt_s: float) -> Floats:
        """Return the joints after a period [s]; those of a sample that moves nothing, or holds nothing, stand."""
        found, reach = self._input(sample), self._options.speed_rad_s * dt_s
        if isinstance(found, str):
            return self._q
        if found.joints is not None:
            return self._q + np.clip(found.joints - self._q, -reach, reach)
        if self._tool is not None and anchor.tool is not None:
            return self._moved_by_tool(self._tool, sample, found, anchor, dt_s)
        way = np.zeros(len(self._joints))
        if sample.twist is None:
            way[self._choice.joint] = arm_input.jog(sample.controls)
        else:
            for joint in self._parts[self._mode]:
                axis, sign = _TURNED_BY_TWIST.get(joint, (0, 0.0))
                way[joint] = sign * min(max(float(sample.twist[axis]), -1.0), 1.0)
        return self._q + way * reach

    def _moved_by_tool(
        self, tool: ArmTool, sample: OperatorSample, found: ArmInput, anchor: _Anchor, dt_s: float
    ) -> Floats:
        options, hand = self._options, self._options.hand
        assert anchor.tool is not None
        if found.poses is not None and hand in anchor.poses:
            forward = anchor.poses.get("head")
            looks = float(rotations.roll_pitch_yaw(forward.quat_wxyz)[2]) if forward is not None else 0.0
            goal = deltas.followed(
                anchor.tool, anchor.poses[hand], found.poses[hand],
                scale=options.scale, heading_rad=looks - options.facing_rad,
            )  # fmt: skip
            return tool.follow(self._q, goal, dt_s, self._lower, self._upper)
        deflection = arm_input.tool_deflection(sample)
        axes = tool.pose(self._q).quat_wxyz if options.frame == "tool" else _about_z(options.facing_rad)
        return tool.twist(self._q, deflection, axes, dt_s, self._lower, self._upper)


def _parts(joints: int) -> dict[str, range]:
    """Return the joints that a twist can turn at a time by what they are called: those near the base, the wrist's."""
    starts = [start for start in (0, 4, 7) if start < joints]
    parts = [range(start, stop) for start, stop in zip(starts, [*starts[1:], joints], strict=True)]
    return {f"joints {part[0] + 1}-{part[-1] + 1}" if len(part) > 1 else f"joint {part[0] + 1}": part for part in parts}


def _command_format(options: ArmOptions) -> tuple[CommandFormat, dict[str, Any]]:
    """Return the format of the commands, and what a manifest says of the limits."""
    if options.command:
        command_format: CommandFormat = registry.find("command", options.command)
        if isinstance(command_format, PartedCommand):
            parts = ", ".join(part.name for part in command_format.parts)
            raise ConfigError(f"command {options.command!r} is made of parts, which are driven apart: {parts}")
        if not command_format.holds_position or any(
            not element.name.endswith("_pos") for element in command_format.elements
        ):
            raise ConfigError(f"command {options.command!r} has other elements than positions of an arm's joints")
        if options.robot:
            if not isinstance(command_format, JointCommand):
                why = f"command {options.command!r} is for {command_format.robot} alone"
                raise ConfigError(f"robot is {options.robot!r}; {why}")
            command_format = replace(command_format, robot=options.robot)
        slowest, facts = (
            float(command_format.rate.min()),
            {name: getattr(command_format, name).tolist() for name in _LIMITS},
        )
    else:
        limits = arm_limits.load(MAKER, options.model, options.limits)
        slowest, facts = float(limits.qd_max.min()), limits.facts()
        robot = suffix(options.model, options.name)
        command_format = arm_command(MAKER, limits, speed_rad_s=options.speed_rad_s, robot=robot)
    if options.speed_rad_s > slowest:
        raise ConfigError(f"speed_rad_s is {options.speed_rad_s:g}; the slowest joint does {slowest:.3g} rad/s")
    return command_format, facts


def _about_z(radians: float) -> Floats:
    return rotations.from_rotation_vector(np.array([0.0, 0.0, radians]))


def _tool(options: ArmOptions) -> ArmTool:
    return ArmTool(
        kinematics.chain(options.model).with_tool(options.tip),
        speed_rad_s=options.speed_rad_s,
        tool_mps=options.tool_mps,
        tool_rad_s=options.tool_rad_s,
        box=np.array([options.box_lower, options.box_upper]),
    )
