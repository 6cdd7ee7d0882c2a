"""One or two GELLO leader arms as an operator's device: joints and grippers."""

from __future__ import annotations

import contextlib
import logging
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from adapters.devices.gello import calibration as calibrations
from adapters.devices.gello import ports
from adapters.devices.gello.bus import BAUDS, MotorBus
from adapters.devices.gello.calibration import Calibration
from adapters.devices.gello.sampler import Sampler
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample
from station.protocols import Floats

log = logging.getLogger(__name__)


class Gello:
    """Reads the leaders: the joints of all, left before right, then their grippers.

    A sample holds what every leader showed at its oldest reading's time, so one leader that falls silent makes the
    whole device stale, and then gone, with the name of the servo.

    Args:
        ports_wanted: Serial ports, one per leader; none for the adapters that are plugged in.
        leaders: How many there are, 1 or 2.
        baud: Rate of the servos [bit/s].
        rate_hz: Readings per second [Hz].
        patience_s: For how long readings may fail before that is a fault [s].
        calibrations_folder: Where calibrations are kept, by serial number.
        by_id: Where ports appear by serial number.
        clock: Of the process.

    Raises:
        DeviceError: no port, several, no permission, no answer, another baud rate, other servos, no calibration, no
            library.
        BadFile: a calibration that cannot be read, or that of another leader.
    """

    def __init__(
        self,
        *,
        ports_wanted: tuple[str, ...] = (),
        leaders: int = 1,
        baud: int = BAUDS[0],
        rate_hz: float = 100.0,
        patience_s: float = 0.25,
        calibrations_folder: Path | None = None,
        by_id: Path = ports.BY_ID,
        clock: Clock = SYSTEM,
    ) -> None:
        folder = calibrations_folder or calibrations.default_folder()
        self._baud = baud
        self._given: tuple[int, ...] = ()
        self._samplers: list[Sampler] = []
        with contextlib.ExitStack() as on_error:
            opened = []
            for port in ports.choose(ports_wanted, leaders, by_id):
                opened.append(_open(port, baud, calibrations.load(folder, ports.serial_of(port, by_id)), clock))
                on_error.callback(opened[-1][1].close)
            opened.sort(key=lambda one: one[0].arm)
            self._calibrations = [calibration for calibration, _ in opened]
            self._ports = [bus.port for _, bus in opened]
            self._check_arms()
            on_error.pop_all()
        for calibration, bus in opened:
            self._samplers.append(Sampler(bus, calibration, rate_hz=rate_hz, patience_s=patience_s))

    def read(self) -> OperatorSample | None:
        """Return the joints of all leaders if they are new since the last call; never blocks.

        Raises:
            DeviceError: a servo is silent, or a port was torn out.
        """
        faults = [sampler.fault for sampler in self._samplers if sampler.fault]
        if faults:
            raise DeviceError("; ".join(faults))
        newest = [sampler.newest for sampler in self._samplers]
        samples = [sample for sample in newest if sample is not None]
        captured = tuple(sample.capture_ns for sample in samples)
        if len(samples) < len(newest) or captured == self._given:
            return None
        self._given = captured
        return OperatorSample(capture_ns=min(captured), joints=self._ordered([sample.values for sample in samples]))

    def why_silent(self) -> str:
        """Return which servo does not answer, once that is known."""
        return "; ".join(sampler.fault for sampler in self._samplers if sampler.fault)

    def facts(self) -> dict[str, Any]:
        """Return the leaders, what `OperatorSample.joints` are called, and the library."""
        return {
            "device": "gello",
            "leaders": [
                {"arm": each.arm, "serial": each.serial, "port": port, "calibrated": each.date, "ids": list(each.ids)}
                for each, port in zip(self._calibrations, self._ports, strict=True)
            ],
            "joints": self._names(),
            "baud": self._baud,
            "library": f"dynamixel-sdk {metadata.version('dynamixel-sdk')}",
        }

    def close(self) -> None:
        """Release the ports."""
        for sampler in self._samplers:
            sampler.close()

    def _ordered(self, values: list[Floats]) -> Floats:
        """Return joints first and grippers last."""
        joints = [each[: len(known.joints)] for each, known in zip(values, self._calibrations, strict=True)]
        grippers = [each[len(known.joints) :] for each, known in zip(values, self._calibrations, strict=True)]
        return np.concatenate([*joints, *grippers])

    def _names(self) -> list[str]:
        joints = [name for each in self._calibrations for name in each.names[: len(each.joints)]]
        return joints + [name for each in self._calibrations for name in each.names[len(each.joints) :]]

    def _check_arms(self) -> None:
        arms = [each.arm for each in self._calibrations]
        if len(set(arms)) < len(arms):
            serials = " and ".join(each.serial for each in self._calibrations)
            raise DeviceError(
                f"leaders {serials} are both calibrated as the {arms[0]} arm; calibrate the other one again: "
                "station devices calibrate gello"
            )


def _open(port: str, baud: int, calibration: Calibration, clock: Clock) -> tuple[Calibration, MotorBus]:
    """Open the port of a leader and see that it is the one that was calibrated."""
    bus = MotorBus(port, baud, clock)
    try:
        found = bus.ping(calibration.ids)
        if not found:
            raise DeviceError(_why_no_answer(bus, calibration.ids[0]))
        calibration.check(found, port)
    except DeviceError:
        bus.close()
        raise
    advice = ports.latency_advice(port)
    if advice:
        log.warning("%s", advice)
    return calibration, bus


def _why_no_answer(bus: MotorBus, first: int) -> str:
    """Say at which rate the first servo would answer; takes 40 ms a rate."""
    bus.close()
    for baud in BAUDS:
        other = MotorBus(bus.port, baud, bus.clock)
        try:
            if baud != bus.baud and other.ping([first]):
                return f"{bus.port}: no servo answers at {bus.baud} baud, but they do at {baud}: set baud: {baud}"
        finally:
            other.close()
    return f"{bus.port}: no servo answers at any baud rate; see to the leader's power and its first cable"
