"""Whether a G1 may be armed, may be driven on, or has to stand: rules over the states that it sends. Pure."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds import messages
from adapters.robots.g1.dds.options import STATE_RATE_HZ
from adapters.robots.g1.joints import G1_29
from station.protocols import FALL_TILT_RAD, Floats
from station.rotations import tilt

JOINTS = len(G1_29)

# Each number is what others run: `terminations.hpp` of unitree_sdk2, SONIC, GR00T.
SILENT_S = 0.1
"""A robot that sent no new state for longer is damped [s]: five control periods."""

_RATE_HZ, _OVER_S = 500.0, 2.0
_TICKS_PER_STATE, _LOST = 2, 0.01
_TILT_RAD, _GYRO_RAD_S, _SPEED_RAD_S = np.radians(10.0), 0.2, 0.3
_COOL_C, _WINDING_C, _CASING_C = 60.0, 120.0, 85.0
_SOC_TO_ARM, _SOC_TO_STAND = 30.0, 10.0
_REMOTE_S, _BATTERY_S = 1.0, 5.0


class HealthMonitor:
    """What the states of the last seconds say.

    Args:
        where: In words, where the states were to come from: ``eno1, domain 0``.
        least_rate_hz: States that have to come before it is armed, of 500 [Hz].

    Attributes:
        damaged: States whose checksum was wrong.
        lost_ticks: Milliseconds of the robot's own time that no state told of, beyond the two between two states.
    """

    def __init__(self, where: str, least_rate_hz: float = STATE_RATE_HZ) -> None:
        self._where, self._least_rate_hz = where, least_rate_hz
        self.damaged = self.lost_ticks = 0
        self._damaged_at: deque[float] = deque(maxlen=64)
        self._came: deque[tuple[float, int, int]] = deque()  # when, how many new ticks, by how much the tick grew
        self._newest: NDArray[Any] | None = None
        self._tick = -1
        self._counted_s = -np.inf  # when a state with a new tick came
        self._heard_s = -np.inf  # when any state came
        self._soc: float | None = None
        self._soc_s = -np.inf
        self._remote_s = -np.inf

    def on_states(self, records: NDArray[Any], damaged: int, now_s: float) -> None:
        """Take the states that came since the last call, oldest first, shape (k,), and how many were damaged."""
        self.damaged += damaged
        self._damaged_at.extend([now_s] * min(damaged, 64))
        if len(records):
            self._heard_s, self._newest = now_s, records[-1]
            ticks: list[int] = records["tick"].tolist()  # of ten numbers NumPy takes eight times as long
            new = [step for step in (after - before for before, after in pairwise([self._tick, *ticks])) if step > 0]
            if self._tick >= 0:
                self.lost_ticks += sum(max(step - 2, 0) for step in new)
            if new:
                if now_s - self._counted_s > SILENT_S:
                    self._came.clear()  # what was lost in a silence says nothing of the line that is back
                self._counted_s = now_s
                self._came.append((now_s, len(new), max(ticks[-1] - self._tick, 0)))
            self._tick = ticks[-1]
            if records["remote"].tobytes().strip(b"\0"):  # in a loop that slept, `any` takes 28 us, and this 6
                self._remote_s = now_s
        while len(self._came) > 1 and now_s - self._came[1][0] >= _OVER_S:  # the first ends what came before
            self._came.popleft()

    def on_battery(self, soc: float, now_s: float) -> None:
        """Take the charge of the battery [%]."""
        self._soc, self._soc_s = soc, now_s

    def why_not_drive(self, now_s: float) -> str:
        """Return why the joints have to be damped now, or ""."""
        silent_s = now_s - self._counted_s
        if silent_s > SILENT_S:
            if now_s - self._heard_s <= SILENT_S:
                return f"its clock stands still: states come, and their tick has not counted for {silent_s:.2f} s"
            return f"no state of the robot for {silent_s:.2f} s on {self._where}"
        if not self._is_finite():
            return "the robot reports what is no number"
        lean = self._lean()
        return f"the pelvis leans {np.degrees(lean):.0f} degrees" if lean > FALL_TILT_RAD else ""

    def why_stand(self, *, is_commanded: bool) -> str:
        """Return why the robot has to stop what it does and stand, or "".

        Args:
            is_commanded: Whether it has been sent commands for a while: then a motor that says it gets none is ill.
                Before, it says what is so; it was sent nothing.
        """
        if self._newest is None:
            return ""
        motors = self._motors()
        for column, limit_c, what in ((1, _WINDING_C, "winding"), (0, _CASING_C, "casing")):
            hottest = int(np.argmax(motors["temperature"][:, column]))
            if motors["temperature"][hottest, column] >= limit_c:
                celsius = motors["temperature"][hottest, column]
                return f"the {what} of {G1_29[hottest]} is at {celsius} °C, the limit is {limit_c:.0f}"
        if error := self._error(0 if is_commanded else messages.TIMED_OUT):
            return error
        if self._soc is not None and self._soc < _SOC_TO_STAND:
            return f"the battery is at {self._soc:.0f} %"
        return ""

    def why_not_arm(self, now_s: float) -> str:
        """Return what the states say against arming, or ""."""
        return self.why_not_drive(now_s) or self._why_irregular(now_s) or self._why_moving() or self._why_weak(now_s)

    def _why_irregular(self, now_s: float) -> str:
        span_s = now_s - self._came[0][0] if self._came else 0.0
        count, grown = sum(row[1] for row in list(self._came)[1:]), sum(row[2] for row in list(self._came)[1:])
        if span_s < _OVER_S:
            return f"its states have come for {span_s:.1f} s; expected {_OVER_S:g} s of them"
        lost = 1.0 - count * _TICKS_PER_STATE / max(grown, 1)  # the robot's tick tells how many it has sent
        # A line that stood still delivers faster for a while: then the rate alone would hide what it loses.
        if count / span_s < self._least_rate_hz or lost > 1.0 - self._least_rate_hz / _RATE_HZ:
            why = (
                f"{lost * 100.0:.0f} % are lost on the way: is the cable good, is this machine busy?"
                if lost >= _LOST
                else "hardly any is lost on the way, the robot sends no more"
            )
            return f"its states come at {count / span_s:.0f} Hz; expected 500: {why}"
        if not 0.9 < grown / (span_s * 1000.0) < 1.1:
            return f"its clock counts {grown / span_s:.0f} ms in a second"
        if self._damaged_at and now_s - self._damaged_at[-1] < _OVER_S:
            return "states came with wrong checksums"
        return ""

    def _why_moving(self) -> str:
        assert self._newest is not None
        if (lean := self._lean()) > _TILT_RAD:
            return f"the pelvis leans {np.degrees(lean):.0f} degrees; expected less than {np.degrees(_TILT_RAD):.0f}"
        turning = float(np.abs(self._newest["gyro"]).max())
        if turning > _GYRO_RAD_S:
            return f"it turns at {turning:.2f} rad/s; hold it still"
        speeds = np.abs(self._motors()["dq"])
        fastest = int(np.argmax(speeds))
        return f"{G1_29[fastest]} moves at {speeds[fastest]:.2f} rad/s" if speeds[fastest] > _SPEED_RAD_S else ""

    def _why_weak(self, now_s: float) -> str:
        if why_stand := self.why_stand(is_commanded=False):
            return why_stand
        hottest = int(np.argmax(self._motors()["temperature"][:, 1]))
        if (celsius := self._motors()["temperature"][hottest, 1]) >= _COOL_C:
            return f"{G1_29[hottest]} is at {celsius} °C; let it cool below {_COOL_C:.0f}"
        if self._soc is None or now_s - self._soc_s > _BATTERY_S:
            return "the battery has said nothing for 5 s"
        if self._soc < _SOC_TO_ARM:
            return f"the battery is at {self._soc:.0f} %; expected {_SOC_TO_ARM:.0f}"
        if now_s - self._remote_s > _REMOTE_S:
            return "the remote is off; switch it on: it is what stops the robot when all else fails"
        return ""

    def _error(self, ignored: int) -> str:
        for name, bits in zip(G1_29, self._motors()["error"].tolist(), strict=True):
            if bits & ~ignored:
                return f"motor {name} reports the error 0x{bits:x}"
        return ""

    def _is_finite(self) -> bool:
        newest, motors = self._newest, self._motors()
        assert newest is not None
        pelvis = bool(np.isfinite(newest["quat_wxyz"]).all() and np.isfinite(newest["gyro"]).all())
        return pelvis and bool(np.isfinite(motors["q"]).all() and np.isfinite(motors["dq"]).all())

    def _motors(self) -> NDArray[Any]:
        assert self._newest is not None
        found: NDArray[Any] = self._newest["motors"][:JOINTS]
        return found

    def _lean(self) -> float:
        if self._newest is None:
            return 0.0
        quat: Floats = self._newest["quat_wxyz"].astype(np.float64)
        return float(tilt(quat / max(float(np.linalg.norm(quat)), 1e-9)))
