"""Inspire's six-motor hands RH56DFX and RH56DFTP: their joints, in the order of their motors. Imports nothing heavy.

A motor is told a part of its way, 1 for open and 0 for closed; the station has angles [rad], between the ends by which
Unitree's own teleoperation scales. No link was measured.

Source: ``robot_hand_inspire.py`` of unitreerobotics/xr_teleoperate (order, ranges); RH56DFTP manual (1000 is open).
"""

from __future__ import annotations

from collections.abc import Mapping

from adapters.robots.legged.table import Joint

_RANGES_RAD = {
    "little": (0.0, 1.7), "ring": (0.0, 1.7), "middle": (0.0, 1.7), "index": (0.0, 1.7), "thumb_bend": (0.0, 0.5),
    "thumb_rotation": (-0.1, 1.3),
}  # fmt: skip

BENT_BY = {name: {"thumb_bend": "thumb"}.get(name, name) for name in _RANGES_RAD}
"""What of a person's hand bends each joint (`adapters.devices.glove.sensors`)."""

# The makers give no torque, and 0.6 s for the whole way without load; no rotor inertia is needed of a motor that takes
# no torques.
_EFFORT_NM, _WAY_S = 1.0, 0.6


def _hand(side: str) -> tuple[Joint, ...]:
    return tuple(
        Joint(f"{side}_hand_{name}", "y", lower, upper, _EFFORT_NM, (upper - lower) / _WAY_S, 0.0)
        for name, (lower, upper) in _RANGES_RAD.items()
    )


JOINTS: Mapping[str, tuple[Joint, ...]] = {side: _hand(side) for side in ("left", "right")}
"""Of each side, from an open hand to a closed one."""
