"""HOMIE's channels, and which part of a G1's command each of them is: the table, and the numbers both ways.

| channel | parts of the command, in the order of the numbers |
|---|---|
| ``pedal_command`` | ``legs``: vx, vy [m/s], yaw rate [rad/s], height of the base [m] |
| ``arm_action`` | ``left_arm``, ``right_arm``: 7 joints each, from the shoulder to the wrist [rad] |
| ``hand_action`` | ``left_hand``, ``right_hand``: 7 joints of a Dex3-1 each, in the order of its motors [rad] |

Whoever commands sends these three. HOMIE's policy hears where the robot is and sends what its legs are to do:

| channel | from | what |
|---|---|---|
| ``state_estimator_data``, ``body_control_data`` | ``g1_control`` | orientation, gyro; 29 joints; 200 times a second |
| ``rc_command`` | ``g1_control`` | the remote's buttons, of which the policy knows R2 |
| ``pd_plustau_targets`` | the policy | ``legs``: the first 12 of 29 joints [rad]; 50 times a second |

HOMIE's ``g1_control`` and ``hand_control`` do what came last for ever, whatever its
range or speed. Facts: InternRobotics/OpenHomie, HomieDeploy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from adapters.commands.g1_parts import ARMS, HANDS, LegsAndArms
from adapters.commands.leg_targets import SHARE, LegTargets
from adapters.commands.velocity import FORMATS, HEIGHT
from adapters.lcm import types
from adapters.lcm.message import MessageType
from station.parts import PartedCommand, part_name
from station.protocols import CommandFormat, Floats
from station.rotations import roll_pitch_yaw, rotate_inverse

Legs = Literal["velocity", "velocity-height"]
"""Command formats of legs that HOMIE's pedals can be; `velocity` has no height."""


class Channel(NamedTuple):
    """A channel on which a robot is commanded.

    Attributes:
        name: Of the channel.
        kind: Type of its messages.
        field: The one field of those.
        parts: Of the robot's command, in the order of its numbers.
    """

    name: str
    kind: MessageType
    field: str
    parts: tuple[str, ...]


CHANNELS = (
    Channel("pedal_command", types.COMMAND, "command", ("legs",)),
    Channel("arm_action", types.ARM_ACTION, "act", ("left_arm", "right_arm")),
    Channel("hand_action", types.HAND_ACTION, "act", ("left_hand", "right_hand")),
)

TARGETS_CHANNEL = Channel("pd_plustau_targets", types.TARGETS, "q_des", ("legs",))
"""On it HOMIE's policy says what the joints are to do; of the legs alone it is obeyed."""

STATE_CHANNEL = "body_control_data"
"""On it ``g1_control`` tells where the 29 joints are, 200 times a second, as `types.BODY_CONTROL`."""

_GRAVITY_M_S2 = 9.81


HANDS_AT_START = {
    "left_hand": (0.0, 1.05, 1.75, -1.57, -1.75, -1.57, -1.75),
    "right_hand": (0.0, -1.05, -1.75, 1.57, 1.75, 1.57, 1.75),
}
"""Where ``hand_control`` has the hands before the first message: closed [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A channel, and the parts of a robot that it commands.

    Attributes:
        channel: The channel.
        formats: Of its parts, in order.
    """

    channel: Channel
    formats: tuple[CommandFormat, ...]

    def commands(self, numbers: Sequence[float]) -> list[list[float]]:
        """Return the command of each part, of the numbers of a message; a height that legs do not take is left out."""
        parts, start = [], 0
        for each in self.formats:
            end = start + len(each.default)
            parts.append([*numbers[start:end]])
            start = end
        return parts

    def numbers(self, parts: Sequence[Sequence[float]]) -> list[float]:
        """Return the numbers of a message, of the command of each part; legs without a height stand as by default."""
        found = [number for part in parts for number in part]
        missing = self.channel.kind.fields[0].length - len(found)
        return found + [HEIGHT.default] * missing


def command_of(robot: str, legs: Legs, *, hands: bool) -> PartedCommand:
    """Return the command of a robot that is commanded as HOMIE's is; its legs' range is that of HOMIE's policy.

    Args:
        robot: Suffix of the robot's keys.
        legs: Registered name of the command format of its legs.
        hands: Whether it has hands.
    """
    from adapters.policies.homie import HomiePolicy  # brings ONNX Runtime, which listing servers does not need

    others = [0.0] * (len(ARMS) + (len(HANDS) if hands else 0))
    count = len(FORMATS[legs].default)
    lower, upper = (np.array([*[pair[end] for pair in HomiePolicy.RANGE[:count]], *others]) for end in (0, 1))
    return LegsAndArms(FORMATS[legs], robot, lower, upper, hands=hands)


def routes(command: PartedCommand) -> tuple[Route, ...]:
    """Return the channels that command a robot; that of hands only where it has some."""
    formats = {part_name(command, part): part for part in command.parts}
    return tuple(
        Route(channel, tuple(formats[name] for name in channel.parts))
        for channel in CHANNELS
        if set(channel.parts) <= formats.keys()
    )


def low_level_of(robot: str) -> PartedCommand:
    """Return the command of a robot whose legs HOMIE's policy moves, and whose arms are commanded as HOMIE's are."""
    return LegsAndArms(LegTargets(), robot)


def low_level_routes(command: PartedCommand) -> tuple[Route, ...]:
    """Return the channels that command such a robot: the targets, and arms."""
    legs, *arms = command.parts
    return Route(TARGETS_CHANNEL, (legs,)), Route(CHANNELS[1], tuple(arms))


def leg_command(targets: Sequence[float]) -> list[float]:
    """Return the command of the legs, 13 numbers, of 29 targets [rad]: followed, with nothing of the station's own."""
    return [*targets[:SHARE], 1.0]


def robot_messages(state: Floats, *, is_pressed: bool) -> dict[str, bytes]:
    """Return what HOMIE's ``g1_control`` tells of a robot, by channel; what it leaves at zero is zero.

    Its accelerometer says what one of a robot at rest does: the policy does not look at it.

    Args:
        state: 29 positions [rad] and velocities [rad/s], orientation wxyz, gyro [rad/s]; shape (65,).
        is_pressed: Whether R2 of the remote is down.
    """
    q, dq, quat_wxyz, gyro = np.split(state, [29, 58, 62])
    zeros = {field.name: [0] * field.length if field.length else 0 for field in types.RC_COMMAND.fields}
    unknown = {field.name: [0.0] * field.length for field in types.STATE_ESTIMATOR.fields if field.length}
    told = {
        "rpy": roll_pitch_yaw(quat_wxyz).tolist(), "omegaBody": gyro.tolist(),
        "aBody": rotate_inverse(quat_wxyz, [0.0, 0.0, _GRAVITY_M_S2]).tolist(),
    }  # fmt: skip
    return {
        "state_estimator_data": types.STATE_ESTIMATOR.encode(unknown | told | {"timestamp_us": 0}),
        STATE_CHANNEL: types.BODY_CONTROL.encode({"q": q.tolist(), "qd": dq.tolist(), "timestamp_us": 0}),
        "rc_command": types.RC_COMMAND.encode(zeros | {"right_lower_right_switch": int(is_pressed)}),
    }
