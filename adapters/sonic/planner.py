"""SONIC's planner: where to go and where to look, as velocities of a robot on legs, and the other way round.

| field of ``planner`` | here |
|---|---|
| ``mode`` | 0 stands, 1 slow walk, 2 walk, 3 run; 4 squat, where the height is a command; others have no meaning here |
| ``movement`` | which way to go in the frame of the stream, whose x was forward when control began; no length |
| ``facing`` | which way to look in that frame: what is left to turn becomes a yaw rate |
| ``speed`` | how fast [m/s]; -1 is the mode's own |
| ``height`` | of the base [m] in mode 4; -1 is none |
| ``upper_body_position``, ``…_velocity``, ``…_hand_joints``, ``vr_…`` | left out: a velocity says nothing of them |

A velocity command has no heading, so neither side can tell where the robot really looks: the heading here is the sum
of the yaw rates, and a robot that slips, or turns slower, is off by that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from adapters.commands.velocity import HEIGHT
from adapters.sonic.message import BadMessage, Message, pack
from station.protocols import Floats

COMMAND, PLANNER = "command", "planner"
"""Topics."""

VERSION = 1
IDLE, SLOW_WALK, WALK, RUN, SQUAT = range(5)
"""Modes; SONIC has 27."""

SPEEDS_M_S = {SLOW_WALK: (0.1, 0.8), WALK: (0.8, 2.5), RUN: (2.5, 7.5)}
"""From which speed to which each mode was trained; a mode without a speed goes at `OWN_SPEED_M_S`."""

OWN_SPEED_M_S = {SLOW_WALK: 0.4, WALK: 0.8, RUN: 2.5}
"""SONIC's own are not published; these are ours."""

FIELDS = frozenset(("mode", "movement", "facing", "speed", "height"))
"""Of ``planner`` that are used."""

TURN_S, MOST_TURN_RAD_S = 0.3, 1.0
"""What is left to turn is turned in so much time, and never faster; SONIC's planner sees where the robot looks."""

_STANDS_M_S = 0.05  # slower is none
_SHORT = 1e-3  # a direction that is shorter is none
_MOST_STEP_S = 0.1  # a pause between messages counts as so much


class Order(NamedTuple):
    """A message of the topic ``command``.

    Attributes:
        start, stop: Whether control begins, or ends.
        is_planner: Whether the planner is obeyed; else streamed poses.
    """

    start: bool
    stop: bool
    is_planner: bool


class Planned(NamedTuple):
    """A message of the topic ``planner``.

    Attributes:
        mode: Mode of locomotion.
        movement, facing: Directions in the frame of the stream, of which x and y count.
        speed: [m/s]; -1 for the mode's own.
        height: Of the base [m]; -1 for none.
    """

    mode: int
    movement: tuple[float, float, float]
    facing: tuple[float, float, float]
    speed: float = -1.0
    height: float = -1.0


def pack_order(order: Order) -> bytes:
    """Return the message of an order."""
    flags = {"start": order.start, "stop": order.stop, "planner": order.is_planner}
    return pack(COMMAND, VERSION, {name: np.array([flag], np.uint8) for name, flag in flags.items()})


def order_of(message: Message) -> Order:
    """Return what a message of the topic ``command`` orders.

    Raises:
        BadMessage: a flag lacks, or is none.
    """
    flags = [message.few(name, 1, among=("u8", "bool", "i32"))[0] != 0 for name in ("start", "stop", "planner")]
    return Order(*flags)


def pack_planned(planned: Planned) -> bytes:
    """Return the message of what is planned."""
    numbers = {name: np.array(getattr(planned, name), np.float32) for name in ("movement", "facing")}
    ends = {name: np.array([getattr(planned, name)], np.float32) for name in ("speed", "height")}
    return pack(PLANNER, VERSION, {"mode": np.array([planned.mode], np.int32)} | numbers | ends)


def planned_of(message: Message) -> Planned:
    """Return what a message of the topic ``planner`` asks for.

    Raises:
        BadMessage: of another version, a field lacks, is of another type or shape, or holds what is no number.
    """
    if message.version != VERSION:
        raise BadMessage("wrong-version", f"version {message.version}, expected {VERSION}")
    (mode,) = message.few("mode", 1, among=("i32",))
    x, y, z = message.few("movement", 3)
    facing_x, facing_y, facing_z = message.few("facing", 3)
    ends = message.number("speed", -1.0), message.number("height", -1.0)
    return Planned(int(mode), (x, y, z), (facing_x, facing_y, facing_z), *ends)


class PlannedVelocity:
    """From what is planned to velocities: forward, left [m/s], turn [rad/s], and the height [m] where that is one.

    Args:
        has_height: Whether the command has a height.
    """

    def __init__(self, *, has_height: bool) -> None:
        self._has_height = has_height
        self._heading: float | None = None  # where the robot looks in the frame of the stream [rad]
        self._at_s = -math.inf

    def realign(self) -> None:
        """Take the robot to look where the next message faces: after a silence nobody knows better."""
        self._heading = None

    def command(self, planned: Planned, arrived_s: float) -> list[float]:
        """Return the command of a message that came at an instant [s], 3 or 4 numbers.

        Raises:
            BadMessage: it asks for what a velocity cannot say.
        """
        if planned.mode not in (IDLE, *OWN_SPEED_M_S, *((SQUAT,) if self._has_height else ())):
            known = "0 to 4" if self._has_height else "0 to 3"
            raise BadMessage("no-meaning", f"mode {planned.mode} has no meaning for this command; expected {known}")
        facing, going = (_direction(each) for each in (planned.facing, planned.movement))
        if self._heading is None:
            self._heading = 0.0 if facing is None else facing
        step_s, self._at_s = min(max(arrived_s - self._at_s, 0.0), _MOST_STEP_S), arrived_s
        forward = left = turn = 0.0
        if planned.mode in OWN_SPEED_M_S:
            if facing is not None:
                turn = math.remainder(facing - self._heading, math.tau) / max(TURN_S, step_s)
                turn = min(max(turn, -MOST_TURN_RAD_S), MOST_TURN_RAD_S)
            if going is not None:
                speed = planned.speed if planned.speed >= 0.0 else OWN_SPEED_M_S[planned.mode]
                ahead = going - self._heading
                forward, left = speed * math.cos(ahead), speed * math.sin(ahead)
            self._heading = math.remainder(self._heading + turn * step_s, math.tau)
        if not self._has_height:
            return [forward, left, turn]
        is_low = planned.mode == SQUAT and planned.height >= 0.0
        return [forward, left, turn, planned.height if is_low else HEIGHT.default]


class VelocityPlan:
    """From velocities to what is planned, 50 times a second or so; the heading is the sum of the yaw rates."""

    def __init__(self) -> None:
        self._heading = 0.0

    def planned(self, velocity: Floats, dt_s: float) -> Planned:
        """Return what asks for a velocity (forward, left [m/s], turn [rad/s]), shape (3,), for a period [s]."""
        forward, left, turn = velocity.tolist()
        self._heading = math.remainder(self._heading + turn * dt_s, math.tau)
        facing = math.cos(self._heading), math.sin(self._heading), 0.0
        speed = math.hypot(forward, left)
        if speed < _STANDS_M_S:
            still = 0.0, 0.0, 0.0
            is_turning = abs(turn) >= _STANDS_M_S
            return Planned(SLOW_WALK, still, facing, 0.0) if is_turning else Planned(IDLE, still, facing)
        ahead = self._heading + math.atan2(left, forward)
        mode = next((mode for mode, (_, most) in SPEEDS_M_S.items() if speed < most), RUN)
        slowest, fastest = SPEEDS_M_S[mode]
        return Planned(mode, (math.cos(ahead), math.sin(ahead), 0.0), facing, min(max(speed, slowest), fastest))


def _direction(vector: tuple[float, float, float]) -> float | None:
    """Return where a vector points, about z [rad]; None where it points nowhere."""
    x, y, _ = vector
    return math.atan2(y, x) if math.hypot(x, y) > _SHORT else None
