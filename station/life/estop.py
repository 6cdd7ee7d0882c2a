"""The emergency stop's keys: what their values ask for. In doubt they ask to stop.

`station.bus.keys.ESTOP` holds a stop or its release. A bus with a user per role lets only the operator write it; all
others press on `station.bus.keys.ESTOP_PRESSED`, whose every write is a stop, whatever its value: a role that may press
can neither release a stop nor overwrite one of somebody else with a release. It is removed by a release.

A restarted bus has forgotten the keys, and a server that starts after that would not know of a latched stop. So those
that do know say it again, but only where the key holds nothing (``SET … NX``, one step of the server's): whatever
anybody has written since, a reset above all, stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from station.bus import acl, codec, keys
from station.bus.client import Bus
from station.bus.sample import Sample
from station.bus.watch import Watch

KEYS = (keys.ESTOP_PRESSED, keys.ESTOP)
"""In the order in which they are read: of a press and a release that came at once, the press is seen first."""

_UNNAMED = "emergency stop"


@dataclass(frozen=True, slots=True)
class StopRequest:
    """What the newest value of one of `KEYS` asks for.

    Attributes:
        stop: Whether to stop; False asks to leave the stop.
        reason: Who asked and why.
        arm: Whether a robot that starts disarmed shall be armed (only together with ``stop: false``).
    """

    stop: bool
    reason: str
    arm: bool = False


def restate(bus: Bus, reason: str, who: str) -> bool:
    """Restate a latched stop where the key is absent; return whether it was.

    Args:
        bus: Which may have forgotten it.
        reason: Why it was stopped.
        who: Who says it again.

    Raises:
        BusError: the bus is lost, or did not answer in time.
    """
    key = acl.stop_key(bus.address.username)
    if key != keys.ESTOP and bus.get(keys.ESTOP) is not None:
        return False
    value = codec.json_object({"stop": True, "reason": reason, "restated_by": who})
    return bus.call("SET", key, value, "NX") is not None


def latched(find: Callable[[str], Sample | None]) -> tuple[StopRequest, Sample] | None:
    """Return the stop that the keys hold, and the sample that asks for it; or None.

    Args:
        find: Returns what a key holds.
    """
    samples = (find(key) for key in KEYS)
    asked = [(read(sample.value, key=sample.key), sample) for sample in samples if sample is not None]
    return next((found for found in asked if found[0].stop), None)


def read(data: bytes, *, key: str = keys.ESTOP) -> StopRequest:
    """Read a value: nothing, ``0`` or an object with ``"stop": false`` resets; whatever else it is, it stops.

    Args:
        data: It.
        key: One of `KEYS`. On `station.bus.keys.ESTOP_PRESSED` nothing resets.
    """
    request = _read(data)
    if key == keys.ESTOP_PRESSED and not request.stop:
        return StopRequest(stop=True, reason=_UNNAMED)
    return request


def _read(data: bytes) -> StopRequest:
    if data.strip() in (b"", b"0"):
        return StopRequest(stop=False, reason="reset by the operator")
    try:
        value = codec.parse_json(data)
    except codec.BadValue:
        return StopRequest(stop=True, reason=_UNNAMED)
    if not isinstance(value, dict):
        return StopRequest(stop=True, reason=_UNNAMED)
    said = ", ".join(str(value[name]) for name in ("who", "reason") if value.get(name))
    if value.get("stop") is False:
        return StopRequest(stop=False, reason=said or "reset by the operator", arm=value.get("arm") is True)
    return StopRequest(stop=True, reason=said or _UNNAMED)


class _Gate(msgspec.Struct):
    state: str = ""
    reason: str = ""
    needs_silence: str = ""


class StopWatch:
    """Whether the stop is latched, for what commands a robot: by its keys, or by the word of the robot that obeys it.

    Args:
        watch: Watches the keys of `watched`.
        robot: Suffix of the robot's keys.
    """

    def __init__(self, watch: Watch, robot: str) -> None:
        self._watch, self._gate_key = watch, keys.command_gate(robot)
        self._was_free = False  # whether the robot was seen in another state than stopped

    @staticmethod
    def watched(robot: str) -> list[str]:
        """Return the keys that must be watched."""
        return [*KEYS, keys.command_gate(robot)]

    def why_stopped(self) -> str:
        """Return why the robot is stopped, or ""; of what its gate says the change counts, as the word may be old."""
        if (found := latched(self._watch.latest)) is not None:
            return found[0].reason
        gate = self._gate()
        self._was_free = self._was_free or gate.state not in ("", "stopped")
        return gate.reason if self._was_free and gate.state == "stopped" else ""

    @property
    def is_gate_old(self) -> bool:
        """Whether the robot's gate has said something, and nothing since this began to watch."""
        sample = self._watch.latest(self._gate_key)
        return sample is not None and sample.arrived_ns is None

    @property
    def needs_silence(self) -> str:
        """Why the robot follows no command before all have ceased for a while, or ""."""
        return self._gate().needs_silence

    def _gate(self) -> _Gate:
        sample = self._watch.latest(self._gate_key)
        if sample is None or sample.arrived_ns is None:
            return _Gate()
        try:
            return codec.parse_struct(sample.value, _Gate)
        except codec.BadValue:
            return _Gate()
