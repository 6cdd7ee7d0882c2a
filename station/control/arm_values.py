"""What a tick of an arm puts on the bus after its target was handed over."""

from __future__ import annotations

import msgspec

from station.bus import codec, keys
from station.control.arm_control import ArmRecord
from station.control.command_path import CommandPath
from station.life.arm_request import ArmAnswer
from station.life.controller_request import ControllerAnswer


def result_values(
    robot: str, record: ArmRecord, commanded: CommandPath, armed: ArmAnswer | None, asked: ControllerAnswer | None
) -> dict[str, bytes]:
    """Return the values of a tick by key.

    Args:
        robot: Suffix of the arm's keys.
        record: What the tick did.
        commanded: Its command's way.
        armed: Answer to the last request to arm.
        asked: Answer to a request to the controller.
    """
    gate = commanded.status(record.decision)
    if record.refusal:
        gate["target_refused"] = record.refusal
    if armed is not None:
        gate["arm"] = msgspec.structs.asdict(armed)
    if asked is not None:
        gate["controller"] = msgspec.structs.asdict(asked)
    return {
        keys.target(robot): codec.f64(record.target),
        keys.command_gate(robot): codec.json_object(gate),
        keys.command_used(robot): codec.f64(record.decision.vector),
        keys.policy_timing(robot): codec.json_vector((record.tick, record.command_seq, *record.timing_ns)),
    }
