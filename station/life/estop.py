"""The emergency stop's key: what its value asks for. In doubt it asks to stop."""

from __future__ import annotations

from dataclasses import dataclass

from station.bus import codec


@dataclass(frozen=True, slots=True)
class StopRequest:
    """What the newest value of `station.bus.keys.ESTOP` asks for.

    Attributes:
        stop: Whether to stop; False asks to leave the stop.
        reason: Who asked and why.
        arm: Whether a robot that starts disarmed shall be armed (only together with ``stop: false``).
    """

    stop: bool
    reason: str
    arm: bool = False


def read(data: bytes) -> StopRequest:
    """Read a value: nothing, ``0`` or an object with ``"stop": false`` resets; whatever else it is, it stops."""
    if data.strip() in (b"", b"0"):
        return StopRequest(stop=False, reason="reset by the operator")
    try:
        value = codec.parse_json(data)
    except codec.BadValue:
        return StopRequest(stop=True, reason="emergency stop")
    if not isinstance(value, dict):
        return StopRequest(stop=True, reason="emergency stop")
    said = ", ".join(str(value[name]) for name in ("who", "reason") if value.get(name))
    if value.get("stop") is False:
        return StopRequest(stop=False, reason=said or "reset by the operator", arm=value.get("arm") is True)
    return StopRequest(stop=True, reason=said or "emergency stop")
