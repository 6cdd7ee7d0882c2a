"""A sensor glove as an operator's device: how far each sensor is closed."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove import ports
from adapters.devices.glove.calibration import Calibration, Side
from adapters.devices.glove.lines import LineReader, Protocol
from adapters.devices.glove.ports import BAUD, GlovePort
from adapters.devices.serial_port import BY_ID, PortReader, Reading, serial_of
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample

BOOT_S = 3.0
"""For the first line: an Arduino starts anew when its port is opened, and its loader waits for up to 2 s."""


class Glove:
    """Reads the glove of one hand.

    Args:
        side: The hand that wears it.
        port: Its serial port; "" for the only adapter that has a calibration of a glove for that side.
        baud: Rate of the port [bit/s].
        protocol: How it has to write; "" for as it did when it was calibrated.
        patience_s: For how long no good line may come before that is a fault [s].
        calibrations_folder: Where calibrations are kept, by serial number and side; None for the user's settings.
        by_id: Where ports appear by serial number.
        clock: Of the process.

    Raises:
        DeviceError: no port, several, no permission, in use, no calibration, one for another protocol, no library.
        BadFile: a calibration that cannot be read, or that of another glove.
    """

    def __init__(
        self,
        *,
        side: Side,
        port: str = "",
        baud: int = BAUD,
        protocol: Protocol | Literal[""] = "",
        patience_s: float = 0.5,
        calibrations_folder: Path | None = None,
        by_id: Path = BY_ID,
        clock: Clock = SYSTEM,
    ) -> None:
        folder = calibrations_folder or calibrations.default_folder()
        chosen = port or ports.choose(side, folder, by_id)
        serial = serial_of(chosen, by_id)
        self._calibration = calibrations.load(folder, serial, side)
        self._file = calibrations.file_of(folder, serial, side)
        if protocol not in ("", self._calibration.protocol):
            raise DeviceError(
                f"glove {serial} was calibrated with protocol: {self._calibration.protocol}, not {protocol}; set that, "
                f"or calibrate it again: station devices calibrate glove --side {side} --protocol {protocol}"
            )
        self._given_ns = 0
        self._port = GlovePort(chosen, baud)
        self._sampler = Sampler(self._port, self._calibration, patience_s=patience_s, clock=clock)

    def read(self) -> OperatorSample | None:
        """Return the newest sample if it is new since the last call; never blocks.

        Raises:
            DeviceError: no good line comes any more, or the port was torn out.
        """
        if self._sampler.fault:
            raise DeviceError(self._sampler.fault)
        newest = self._sampler.newest
        if newest is None or newest.capture_ns == self._given_ns:
            return None
        self._given_ns = newest.capture_ns
        return OperatorSample(capture_ns=newest.capture_ns, joints=newest.values)

    def why_silent(self) -> str:
        """Return why no sample comes, as far as that is known."""
        return self._sampler.fault or self._sampler.why_silent()

    def facts(self) -> dict[str, Any]:
        """Return the glove, what `OperatorSample.joints` are called, its calibration, and the library."""
        known = self._calibration
        return {
            "device": "glove",
            "side": known.side,
            "serial": known.serial,
            "port": self._port.port,
            "baud": self._port.baud,
            "protocol": known.protocol,
            "joints": list(known.names),
            "calibration": str(self._file),
            "calibrated": known.date,
            "library": f"pyserial {metadata.version('pyserial')}",
        }

    def close(self) -> None:
        """Release the port."""
        self._sampler.close()


class Sampler(PortReader):
    """The thread that reads the port; its values say how far each sensor is closed, 0 to 1.

    Bad lines are dropped and counted. None that is good for longer than `patience_s` (`BOOT_S` for the first one) is a
    fault that says what came instead, and the end of the thread: how the hand was held is never given in place of how
    it is.

    Args:
        port: The glove's, which is this thread's from now on until `close`.
        calibration: Of the glove.
        patience_s: For how long no good line may come [s].
        clock: Of the process.
    """

    def __init__(self, port: GlovePort, calibration: Calibration, *, patience_s: float, clock: Clock) -> None:
        super().__init__(clock)
        self._port, self._calibration = port, calibration
        self._reader = LineReader(calibration.protocol, calibration.numbers)
        self._patience_s = patience_s
        self._since = (0, 0)  # bytes and bad lines when the last good line came
        self.start(f"glove-{calibration.serial}")

    def why_silent(self) -> str:
        """Return what has come since the last good line, and what was expected."""
        bytes_then, bad_then = self._since
        glove = f"the {self._calibration.side} glove {self._calibration.serial}"
        if self._reader.received == bytes_then:
            return f"nothing comes from {glove}; see to its power and cable"
        expected = f"expected {self._reader.expected}"
        if self._reader.bad == bad_then:
            return f"no whole line comes from {glove}; {expected}, and the end of a line; see to baud:"
        return (
            f"no good line comes from {glove}; the last bad one is '{self._reader.last_bad}', {expected}; see to baud:"
        )

    def _release(self) -> None:
        self._port.close()

    def _read_until_stopped(self) -> None:
        good_s, patience_s = self._clock.monotonic_s(), max(self._patience_s, BOOT_S)
        self._port.drop()
        while not self._stop.is_set():
            lines = self._reader.feed(self._port.read())
            now_ns = self._clock.monotonic_ns()
            if lines:
                self.newest = Reading(now_ns, self._calibration.values(lines[-1]))
                self._since = (self._reader.received, self._reader.bad)
                good_s, patience_s = now_ns * 1e-9, self._patience_s
            elif now_ns * 1e-9 - good_s > patience_s:
                self.fault = f"{self.why_silent()} (for {patience_s:g} s)"
                return
