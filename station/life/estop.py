"""The emergency stop's key: what its value asks for. In doubt it asks to stop.

A restarted bus has forgotten the key, and who starts after that would not know of a latched stop. So those who do know
say it again, but only where the key holds nothing (``SET … NX``, one step of the server's): whatever anybody has
written since, a reset above all, stands.
"""

from __future__ import annotations

from dataclasses import dataclass

from station.bus import codec, keys
from station.bus.client import Bus


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


def restate(bus: Bus, reason: str, who: str) -> bool:
    """Say a latched stop again where the key is absent; return whether it was.

    Args:
        bus: Which may have forgotten it.
        reason: Why it was stopped.
        who: Who says it again.

    Raises:
        BusError: the bus is lost, or did not answer in time.
    """
    value = codec.json_object({"stop": True, "reason": reason, "restated_by": who})
    return bus.call("SET", keys.ESTOP, value, "NX") is not None


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
