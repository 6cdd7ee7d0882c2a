"""What hands tell of each of their joints: field of the message, name, unit. Imports nothing heavy."""

from __future__ import annotations

Columns = tuple[tuple[str, str, str], ...]

_ANGLE = ("q", "pos", "rad")

DEX3: Columns = (
    _ANGLE, ("dq", "vel", "rad/s"), ("tau", "torque", "N m"), ("casing", "casing", "degC"),
    ("winding", "winding", "degC"), ("voltage", "voltage", "V"), ("error", "error", ""),
)  # fmt: skip
DFX: Columns = (_ANGLE, ("temperature", "temperature", "degC"), ("lost", "lost", ""))
DFTP: Columns = (
    _ANGLE, ("force", "force", ""), ("current", "current", ""), ("error", "error", ""), ("status", "status", ""),
    ("temperature", "temperature", "degC"),
)  # fmt: skip
"""Force and current are as the hand reports them: the manual gives no units."""
