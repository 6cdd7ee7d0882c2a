"""A spacemouse as an operator's device: a twist and buttons."""

from __future__ import annotations

from importlib import metadata
from typing import Any

import numpy as np

from adapters.devices.spacemouse.find import choose, library, open_all
from adapters.devices.spacemouse.reports import Deflection, with_dead_band
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample
from station.protocols import Floats

_REPORT_BYTES = 64
_MOST_REPORTS = 10_000  # per tick; a kernel keeps 64, so more than that is a device gone mad


class Spacemouse:
    """Reads a spacemouse through hidapi.

    Every call takes in all reports that have queued up, so that the robot stops when the hand does. It sends only while
    it is touched: silence is rest. But a hand on the cap sends all the time, so a deflection that nothing has confirmed
    for a while (a wireless mouse out of reach, a lost report) counts as let go. A mouse that is torn out gives one more
    sample, of rest, before it is gone.

    Args:
        serial, path: Which one, where several are plugged in; "" for the only one.
        dead_band: Part of full deflection below which an axis counts as zero.
        scale: Factor of each axis vx vy vz wx wy wz, -1 to 1.
        silence_s: After how long without a report a deflection counts as let go [s].
        clock: Of the process.

    Raises:
        DeviceError: no such mouse, several, no permission, or no library.
    """

    def __init__(
        self,
        *,
        serial: str = "",
        path: str = "",
        dead_band: float = 0.05,
        scale: tuple[float, ...] = (1.0,) * 6,
        silence_s: float = 0.5,
        clock: Clock = SYSTEM,
    ) -> None:
        self._clock = clock
        self._dead_band, self._scale, self._silence_s = dead_band, np.array(scale), silence_s
        hid = library()
        self._mouse = choose(hid, serial=serial, path=path)
        self._interfaces = open_all(hid, self._mouse)
        self._deflection = Deflection()
        self._confirmed_s = self._clock.monotonic_s()
        self._reports = 0
        self._lost = ""

    def read(self) -> OperatorSample | None:
        """Return twist and buttons as they are now; never blocks.

        Raises:
            DeviceError: it was torn out, and a sample of rest has been given.
        """
        if self._lost:
            self.close()
            raise DeviceError(self._lost)
        try:
            count = sum(self._drain(interface) for interface in self._interfaces)
        except (OSError, ValueError) as error:
            self._lost = f"{self._mouse}: gone ({error}); plug it in again"
            self._deflection.release()
            return self._reading()
        now_s = self._clock.monotonic_s()
        if count:
            self._confirmed_s = now_s
        elif now_s - self._confirmed_s > self._silence_s:
            self._deflection.centre()
        return self._reading()

    def why_silent(self) -> str:
        """Return nothing: a spacemouse that is there is never silent, it rests."""
        return self._lost

    def facts(self) -> dict[str, Any]:
        """Return model, serial number, interfaces, buttons and library."""
        return {
            "device": "spacemouse",
            "model": self._mouse.model.name,
            "serial": self._mouse.serial,
            "paths": [path.decode(errors="replace") for path in self._mouse.paths],
            "buttons": {f"button_{bit}": label for bit, label in self._mouse.model.buttons.items()},
            "dead_band": self._dead_band,
            "scale": self._scale.tolist(),
            "library": f"hidapi {metadata.version('hidapi')}",
        }

    def close(self) -> None:
        """Close its interfaces."""
        interfaces, self._interfaces = self._interfaces, []
        for interface in interfaces:
            interface.close()

    def _drain(self, interface: Any) -> int:
        """Read all reports that wait; return how many told of motion or buttons."""
        count = 0
        for _ in range(_MOST_REPORTS):
            report = interface.read(_REPORT_BYTES)
            if not report:
                break
            count += self._deflection.update(bytes(report))
        self._reports += count
        return count

    def _reading(self) -> OperatorSample:
        buttons = self._deflection.pop_pressed()
        return OperatorSample(
            twist=self._twist(),
            controls={f"button_{bit}": float(buttons >> bit & 1) for bit in self._mouse.model.buttons},
        )

    def _twist(self) -> Floats:
        return np.asarray(with_dead_band(self._deflection.twist(), self._dead_band) * self._scale + 0.0)
