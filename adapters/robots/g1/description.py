"""What a G1 says of itself, and what TWIST's and TWIST2's own programs would say of theirs if they said anything."""

from __future__ import annotations

from typing import TYPE_CHECKING

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_23, hand
from adapters.robots.legged.description import described
from adapters.robots.legged.unitree import G1
from station.bus.robot_streams import GYRO, POSITIONS, command_streams, driven_by_policy
from station.contract import Codec, Contract, Element, Role, elements, positions
from station.description import ROBOT, RobotDescription, RobotFamily

if TYPE_CHECKING:  # it loads NumPy
    from station.protocols import CommandFormat

_SIDES = ("left", "right")
_ROLL_PITCH = ("root_roll", "root_pitch")
_NECK = elements((("neck_yaw", "neck_pitch"), "rad"))


def describe(robot: str) -> RobotDescription | None:
    """Return the description of a G1 under one of the two names that TWIST and TWIST2 know; None for another name."""
    return _described(robot, driven_by_policy()) if robot in _STOCK else None


def of_server(command_format: CommandFormat) -> RobotDescription:
    """Return the description of a G1 whose policy takes a command."""
    return _described(
        command_format.robot, (*command_streams(command_format), *driven_by_policy(command_format.elements))
    )


def _described(robot: str, driven: tuple[Contract, ...]) -> RobotDescription:
    streams = (*_STOCK.get(robot, ()), *driven)
    return described(G1, robot, streams, short="g1", parts=_PARTS.get(robot, {}))


def _hand(side: str) -> tuple[Element, ...]:
    return elements((positions(hand(side)), "rad"))


def _twist2() -> tuple[Contract, ...]:
    def make(key: str, role: Role, codec: Codec, items: tuple[Element, ...] = (), note: str = "",
             rate_hz: float | None = 50.0) -> Contract:  # fmt: skip
        return Contract(key=key, family="twist2", role=role, codec=codec, elements=items, rate_hz=rate_hz, note=note)

    state = (*elements((GYRO, "rad/s"), (_ROLL_PITCH, "rad")), *POSITIONS)
    return (
        *(make(twist_keys.action_hand(side, ROBOT), "command", "json-vector", _hand(side)) for side in _SIDES),
        make(twist_keys.action_neck(ROBOT), "command", "json-vector", _NECK),
        make(twist_keys.T_ACTION, "command", "integer", note="wall clock of the command, milliseconds since the epoch"),
        make(twist_keys.state_body(ROBOT), "state", "json-vector", state,
             "gyro in the root frame, unscaled; stock servers write 127 zeros once at start"),
        *(make(twist_keys.state_hand(side, ROBOT), "state", "json-vector", _hand(side)) for side in _SIDES),
        make(twist_keys.state_neck(ROBOT), "state", "json-vector", _NECK),
        make(twist_keys.T_STATE, "state", "integer", note="wall clock of the state, milliseconds since the epoch"),
        make(twist_keys.CONTROLLER_DATA, "sensor", "json", note="LeftController, RightController, timestamp [ns]",
             rate_hz=100.0),
        make(twist_keys.MOTION_START_SIGNAL, "control", "text", note="1 while B is the only button, else 0"),
        make(twist_keys.MOTION_EXIT_SIGNAL, "control", "text", note="1 while Select is the only button, else 0"),
    )  # fmt: skip


def _twist() -> tuple[Contract, ...]:
    hands = _hand("left") + _hand("right")
    scaled = (
        elements((tuple(f"scaled_{name}" for name in GYRO), "0.25 rad/s"), (_ROLL_PITCH, "rad"))
        + elements((tuple(f"{name}_pos_from_default" for name in G1_23), "rad"))
        + elements((tuple(f"scaled_{name}_vel" for name in G1_23), "0.05 rad/s"))
        + elements((tuple(f"{name}_previous_action" for name in G1_23), ""))
    )

    def make(key: str, role: Role, items: tuple[Element, ...], note: str) -> Contract:
        return Contract(
            key=key, family="twist", role=role, codec="json-vector", elements=items, rate_hz=50.0, note=note
        )

    return (
        make(twist_keys.action_hands(ROBOT), "command", hands, "left hand, then right hand"),
        make(twist_keys.state_body(ROBOT), "state", scaled,
             "scaled proprioception; ankle velocities are zero; stock servers write 105 zeros once at start"),
        make(twist_keys.state_hands(ROBOT), "state", hands, "left hand, then right hand"),
    )  # fmt: skip


_PARTS = {
    twist_keys.TWIST2_ROBOT: {
        **{
            f"{side} hand": (twist_keys.action_hand(side, ROBOT), twist_keys.state_hand(side, ROBOT))
            for side in ("left", "right")
        },
        "neck": (twist_keys.action_neck(ROBOT), twist_keys.state_neck(ROBOT)),
    },
    twist_keys.TWIST_ROBOT: {"hands": (twist_keys.action_hands(ROBOT), twist_keys.state_hands(ROBOT))},
}
_STOCK = {twist_keys.TWIST2_ROBOT: _twist2(), twist_keys.TWIST_ROBOT: _twist()}

FAMILY = RobotFamily((twist_keys.TWIST2_ROBOT, twist_keys.TWIST_ROBOT), describe)
