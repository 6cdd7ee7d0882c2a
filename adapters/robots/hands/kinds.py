"""Hands as robots that can be named; imports nothing heavy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import hand, select
from adapters.robots.hands import inspire
from adapters.robots.hands.columns import DEX3, DFTP, DFX, Columns
from adapters.robots.hands.options import Dex3Options, HandOptions
from adapters.robots.legged.table import Joint
from station.bus import codec, keys
from station.bus.robot_streams import command_streams, driven_by_policy
from station.contract import Contract, elements
from station.description import JOINT, ROBOT, RobotDescription
from station.description import Joint as DescribedJoint
from station.robot_kind import RobotKind

if TYPE_CHECKING:  # they load NumPy, or DDS
    from adapters.robots.hands.wire import HandWire
    from station.protocols import CommandFormat, Policy, Robot, RobotState

_FINGERS = ("thumb_0", "thumb_1", "thumb_2")
_ORDERS = {
    "middle-index": (*_FINGERS, "middle_0", "middle_1", "index_0", "index_1"),
    "index-middle": (*_FINGERS, "index_0", "index_1", "middle_0", "middle_1"),
}
_SENSORS, _CELLS = 9, 12

_PRESSURE = Contract(
    key=keys.state(f"pressure_{ROBOT}"), family="station", role="state", codec="f64", rate_hz=50.0,
    elements=elements((tuple(f"pressure_{sensor}_{cell}" for sensor in range(_SENSORS) for cell in range(_CELLS)), "")),
    note="as the hand sends it: 100000 and more is a pressure, 30000 is no sensor",
)  # fmt: skip


def motors_of(side: str, order: str) -> tuple[str, ...]:
    """Return the joints of a Dex3-1 in the order of its motors (`Dex3Options.motors`)."""
    return tuple(f"{side}_hand_{name}" for name in _ORDERS[order]) if order in _ORDERS else hand(side)


def dex3_wire(side: str, options: Dex3Options) -> HandWire:
    """Return how a Dex3-1 is spoken with."""
    from adapters.robots.hands.wire import Dex3Wire

    return Dex3Wire(side, select(hand(side)), motors_of(side, options.motors))


def _dftp(side: str, _: HandOptions) -> HandWire:
    from adapters.robots.hands.wire import DftpWire

    return DftpWire(side, inspire.JOINTS[side])


def _dfx(_: HandOptions) -> HandWire:
    from adapters.robots.hands.wire import DfxWire

    return DfxWire(inspire.JOINTS["left"], inspire.JOINTS["right"])


def _stock(side: str, state: RobotState, policy: Policy, robot: str) -> Mapping[str, bytes]:
    """What TWIST2's programs read of a hand."""
    is_theirs = robot == f"{twist_keys.TWIST2_ROBOT}_{side}_hand"
    return {twist_keys.state_hand(side): codec.json_vector(state.q)} if is_theirs else {}


def _kind(
    name: str, about: str, model: str, joints: tuple[Joint, ...], columns: Columns,
    wire: Callable[[Any], HandWire], options: type[HandOptions] = HandOptions, *, pressure: tuple[Contract, ...] = (),
    values: Callable[[RobotState, Policy, str], Mapping[str, bytes]] | None = None,
) -> RobotKind:  # fmt: skip
    samples = Contract(
        key=keys.state(f"samples_{ROBOT}"), family="station", role="state", codec="f64-rows", rate_hz=50.0,
        elements=elements(*(((f"{JOINT}_{suffix}",), unit) for _, suffix, unit in columns)),
        note="every state that the hand sent since the last write: a row each, oldest first",
    )  # fmt: skip

    def make(options: HandOptions, control_dt_s: float) -> Robot:
        from adapters.robots.hands.hand import DdsHand

        return DdsHand(wire(options), options, control_dt_s)

    def describe(command_format: CommandFormat) -> RobotDescription:
        return RobotDescription(
            name=command_format.robot,
            model=model,
            joints=tuple(
                DescribedJoint(each.name, each.lower, each.upper, each.velocity_rad_s, each.effort_nm)
                for each in joints
            ),
            is_carried=True,
            streams=(
                *command_streams(command_format), *driven_by_policy(command_format.elements), samples, *pressure
            ),
        )  # fmt: skip

    return RobotKind(
        name=name, about=about, is_simulated=False, options=options, make=make, describe=describe, values=values,
        policy="direct", checkpoint=f"builtin:{model}.hand.yaml", library="cyclonedds", extra="g1",
    )  # fmt: skip


def _dex3_kind(side: str) -> RobotKind:
    return _kind(
        f"dex3-{side}-dds", f"Unitree's Dex3-1, the {side} hand, over its robot's network", f"unitree_dex3_{side}",
        select(hand(side)), DEX3, partial(dex3_wire, side), Dex3Options, pressure=(_PRESSURE,),
        values=partial(_stock, side),
    )  # fmt: skip


def _dftp_kind(side: str) -> RobotKind:
    return _kind(
        f"inspire-dftp-{side}-dds", f"Inspire's RH56DFTP, the {side} hand, over its robot's network",
        f"inspire_dftp_{side}", inspire.JOINTS[side], DFTP, partial(_dftp, side),
    )  # fmt: skip


DEX3_LEFT, DEX3_RIGHT = _dex3_kind("left"), _dex3_kind("right")
DFTP_LEFT, DFTP_RIGHT = _dftp_kind("left"), _dftp_kind("right")
DFX_BOTH = _kind(
    "inspire-dfx-dds", "Inspire's RH56DFX, both hands, over its robot's network", "inspire_dfx",
    (*inspire.JOINTS["left"], *inspire.JOINTS["right"]), DFX, _dfx,
)  # fmt: skip
