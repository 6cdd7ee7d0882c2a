"""Playing a script through a service: what a frame holds at a time, and when it is sent."""

from __future__ import annotations

import bisect
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from adapters.devices.fakes.pico import wire
from adapters.devices.fakes.pico.scene import moved, scene_of
from adapters.devices.fakes.pico.script import Fault, Script
from adapters.devices.fakes.pico.service import PicoService
from adapters.devices.pico.controls import CONTROLS
from adapters.retarget import frames
from station.operator.sample import Body, OperatorSample, Pose, Side
from station.protocols import Floats

_PRESS_S = 0.2
_FAULT_S = 1.0
_TREMBLE_M = 1e-5
_STILL = "0,0,0,0,0,0"  # velocities and accelerations, which are not to be used: see the adapter
_SLICE_S = 0.1
_ROUNDING = 1e-9
_ONE_FRAME = ("torn", "poison")


class Wearer:
    """Makes the frames of a script; the same ones, whenever and however often it is asked.

    Args:
        script: What is played.
    """

    def __init__(self, script: Script) -> None:
        self._script, self._scene = script, scene_of(script)
        named = (name for control in script.controls for name in (control.set or [control.press]))
        self._at_rest = dict.fromkeys([*CONTROLS, *named], 0.0)
        self._is_recorded = bool(script.frames) and script.between == "hold"
        self._times_s = [frame.at_s for frame in script.frames] if self._is_recorded else []
        self._spoilt = {self.number(fault.at_s): fault.kind for fault in script.faults if fault.kind in _ONE_FRAME}

    def time_s(self, number: int) -> float:
        """Return the time of a frame [s]: that of its recording, or so many periods after the beginning."""
        beyond = number - len(self._times_s)
        if beyond < 0:
            return self._times_s[number]
        return (
            (self._times_s[-1] + (beyond + 1) / self._script.rate_hz)
            if self._times_s
            else number / self._script.rate_hz
        )

    def number(self, time_s: float) -> int:
        """Return the number of the first frame at or after a time [s]."""
        if self._times_s and time_s <= self._times_s[-1]:
            return bisect.bisect_left(self._times_s, time_s)
        began_s, count = (self._times_s[-1], len(self._times_s) - 1) if self._times_s else (0.0, 0)
        return count + math.ceil((time_s - began_s) * self._script.rate_hz - _ROUNDING)

    def next_number(self, number: int, now_s: float) -> int:
        """Return the number of the frame that follows one, when it is a time of the script now [s].

        A headset drops what it cannot send in time; but a frame that the script spoils is always sent.
        """
        newest_due = self.number(now_s)
        newest_due -= self.time_s(newest_due) > now_s
        spoilt = [other for other in self._spoilt if number < other <= newest_due]
        return min(spoilt, default=max(number + 1, newest_due))

    def fault(self, time_s: float, *kinds: str) -> Fault | None:
        """Return the fault of one of some kinds that is on at a time [s], or None."""
        for fault in self._script.faults:
            if fault.kind in kinds and fault.at_s <= time_s < fault.at_s + _lasts_s(fault):
                return fault
        return None

    def frame(self, number: int, began_ns: int) -> wire.Frame | None:
        """Return the frame of a number, from 0, as the app sends it; None where it sends none.

        Args:
            number: Its number.
            began_ns: When the script began, on the headset's clock [ns].
        """
        if (given := self.sample(number)) is None:
            return None
        stamped_s, reading = given
        found = _as_sent(reading, began_ns + round(stamped_s * 1e9))
        self._spoil(found, self.time_s(number), number)
        return found

    def sample(self, number: int) -> tuple[float, OperatorSample] | None:
        """Return stamp [s, time of the script] and content of the frame of a number; None where none is sent."""
        time_s = self.time_s(number)
        if self.fault(time_s, "silence", "crash"):
            return None
        frozen = self.fault(time_s, "freeze")
        return frozen.at_s if frozen else time_s, self._reading(time_s, number)

    def spoilt(self, number: int) -> str:
        """Return how the frame of a number is broken: ``torn``, ``poison``, or ""."""
        return self._spoilt.get(number, "")

    def _reading(self, time_s: float, number: int) -> OperatorSample:
        reading = self._scene(time_s)
        for fault in self._script.faults:
            if fault.kind == "jump" and fault.at_s <= time_s < fault.at_s + (fault.for_s or math.inf):
                reading = moved(reading, np.array(fault.by_m), math.radians(fault.turn_deg))
        shake_m = 0.0 if self._is_recorded else _TREMBLE_M * (number % 2)
        return OperatorSample(
            head=reading.head,
            left=_trembling(reading.left, shake_m),
            right=_trembling(reading.right, shake_m),
            body=reading.body,
            hands={side: _shaken(hand, shake_m) for side, hand in reading.hands.items()},
            controls={**self._at_rest, **reading.controls, **self._controls(time_s)},
        )

    def _controls(self, time_s: float) -> dict[str, float]:
        held: dict[str, float] = {}
        for control in self._script.controls:
            lasts_s = control.for_s or (_PRESS_S if control.press else math.inf)
            if control.at_s <= time_s < control.at_s + lasts_s:
                held |= {control.press: 1.0} if control.press else control.set
        return held

    def _spoil(self, frame: dict[str, Any], time_s: float, number: int) -> None:
        if self.fault(time_s, "no-body"):
            frame.pop("Body", None)
        if self.fault(time_s, "no-controllers"):
            frame.pop("Controller", None)
        kind = self.spoilt(number)
        if kind == "torn":
            del frame["Head"]["pose"]
        elif kind == "poison":
            frame["Head"]["pose"] = "nowhere,0,0,0,0,0,1"


def play(script: Script, service: PicoService, stopping: Callable[[], bool], *, start_s: float = 0.0) -> None:
    """Send the frames of a script on time, until asked to stop; it goes on after its last event.

    Args:
        script: What is played.
        service: Sends them; goes down and comes up again where the script says so.
        stopping: Whether to stop; looked at ten times a second at least.
        start_s: Time of the script to begin at [s].
    """
    wearer = Wearer(script)
    began_s, began_ns = time.monotonic() - start_s, time.time_ns() - round(start_s * 1e9)
    number, is_up = wearer.number(start_s), True
    while not stopping():
        due_s = wearer.time_s(number)
        if not _sleep_until(began_s + due_s, stopping):
            return
        is_wanted = wearer.fault(due_s, "crash") is None
        if is_up != is_wanted:
            service.start() if is_wanted else service.stop()
            is_up = is_wanted
        if is_up and (frame := wearer.frame(number, began_ns)) is not None:
            service.send(frame)
        number = wearer.next_number(number, time.monotonic() - began_s)


def _sleep_until(instant_s: float, stopping: Callable[[], bool]) -> bool:
    while (left_s := instant_s - time.monotonic()) > 0.0:
        time.sleep(min(left_s, _SLICE_S))
        if stopping():
            return False
    return True


def _lasts_s(fault: Fault) -> float:
    return fault.for_s or _FAULT_S


def _as_sent(reading: OperatorSample, stamp_ns: int) -> dict[str, Any]:
    """Return a sample in the words and the frame of the headset's app."""
    found: dict[str, Any] = {"timeStampNs": stamp_ns, "predictTime": 0, "appState": {"focus": True}, "Input": 1}
    if reading.head is not None:
        found["Head"] = {"pose": _pose(reading.head), "status": 3, "handMode": 0}
    if reading.left is not None and reading.right is not None:
        pair: dict[Side, Pose] = {"left": reading.left, "right": reading.right}
        found["Controller"] = {side: _controller(side, pose, reading.controls) for side, pose in pair.items()}
    if reading.body is not None:
        found["Body"] = {"dt": 0, "flags": 0, "timeStampNs": stamp_ns, "joints": _joints(reading.body, stamp_ns)}
    if reading.hands:
        found["Hand"] = {f"{side}Hand": _hand(reading.hands.get(side)) for side in ("left", "right")}
    return found


def _controller(side: Side, pose: Pose, values: Mapping[str, float]) -> dict[str, Any]:
    found: dict[str, Any] = {"pose": _pose(pose)}
    for name, control in CONTROLS.items():
        if control.side == side:
            found[control.field] = values[name] > 0.5 if control.kind == "button" else values[name]
    return found


def _joints(body: Body, stamp_ns: int) -> list[dict[str, Any]]:
    rows = zip(body.positions, body.quats_wxyz, strict=True)
    return [{"p": _pose(Pose(*row)), "t": stamp_ns, "va": _STILL, "wva": _STILL} for row in rows]


def _hand(hand: Floats | None) -> dict[str, Any]:
    rows = [Pose(row[:3], row[3:]) for row in hand] if hand is not None else []
    nowhere = {"p": "0,0,0,0,0,0,0", "s": 0, "r": 0}
    places = [{"p": _pose(pose), "s": 15, "r": 0.01} for pose in rows] or [nowhere] * 26
    return {"isActive": int(hand is not None), "count": 26, "scale": 1, "HandJointLocations": places}


def _pose(pose: Pose) -> str:
    quat = frames.xyzw(frames.quats_from_flu(pose.quat_wxyz))
    return wire.numbers([*frames.positions_from_flu(pose.position).tolist(), *quat.tolist()])


def _trembling(pose: Pose | None, by_m: float) -> Pose | None:
    return pose and Pose(_shaken(pose.position, by_m), pose.quat_wxyz)


def _shaken(rows: Floats, by_m: float) -> Floats:
    """Move the last axis's first element."""
    shaken = rows.copy()
    shaken[..., 0] += by_m
    return shaken
