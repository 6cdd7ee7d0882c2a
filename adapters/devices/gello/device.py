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
from adapters.devices.gello.bus import BUSES, MotorBus, NoSuchRate, Servos, model_name
from adapters.devices.gello.calibration import Calibration
from adapters.devices.serial_port import BY_ID, PortReader, Reading, serial_of
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
        servos: Whose servos they have.
        baud: Rate of the servos [bit/s]; None for the most usual of theirs.
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
        servos: Servos = "dynamixel",
        baud: int | None = None,
        rate_hz: float = 100.0,
        patience_s: float = 0.25,
        calibrations_folder: Path | None = None,
        by_id: Path = BY_ID,
        clock: Clock = SYSTEM,
    ) -> None:
        folder = calibrations_folder or calibrations.default_folder()
        self._kind = BUSES[servos]
        self._baud = baud or self._kind.bauds[0]
        self._given: tuple[int, ...] = ()
        self._samplers: list[Sampler] = []
        with contextlib.ExitStack() as on_error:
            opened = []
            for port in ports.choose(ports_wanted, leaders, by_id, servos):
                calibration = calibrations.load(folder, serial_of(port, by_id))
                opened.append(_open(self._kind, port, self._baud, calibration, clock))
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
            "servos": self._kind.servos,
            "library": f"{self._kind.library} {metadata.version(self._kind.library)}",
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


def _open(
    kind: type[MotorBus], port: str, baud: int, calibration: Calibration, clock: Clock
) -> tuple[Calibration, MotorBus]:
    """Open the port of a leader and see that it is the one that was calibrated."""
    _expect_servos(kind.servos, port, calibration)
    bus = kind(port, baud, clock)
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


def _expect_servos(servos: Servos, port: str, calibration: Calibration) -> None:
    """See that no servo that was calibrated is known to be another maker's, for none of those would answer."""
    for model in calibration.models.values():
        for maker, bus in BUSES.items():
            if maker != servos and model in bus.models:
                raise DeviceError(
                    f"{port}: leader {calibration.serial} was calibrated with servos {model_name(model)} of {maker}, "
                    f"expected those of {servos}; set servos: {maker}, or calibrate this leader: "
                    f"station devices calibrate gello --servos {servos}"
                )


def _why_no_answer(bus: MotorBus, first: int) -> str:
    """Return at which rate the first servo would answer; takes 40 ms a rate."""
    bus.close()
    for baud in bus.bauds:
        try:
            other = type(bus)(bus.port, baud, bus.clock)
        except NoSuchRate:
            continue  # the servos cannot be at a rate that the adapter cannot do
        try:
            if baud != bus.baud and other.ping([first]):
                return f"{bus.port}: no servo answers at {bus.baud} baud, but they do at {baud}: set baud: {baud}"
        finally:
            other.close()
    return f"{bus.port}: no servo answers at any baud rate; see to the leader's power and its first cable"


class Sampler(PortReader):
    """The thread that reads a leader; its values are joints [rad] and the gripper, 0 to 1.

    Torn packets are read again. A servo that is silent for longer than `patience_s` is a fault with its name, and the
    end of the thread: what the joints were is never given in place of what they are.

    Args:
        bus: The servos' bus, which is this thread's from now on until `close`.
        calibration: Of the leader on it.
        rate_hz: Readings per second [Hz].
        patience_s: For how long a reading may fail [s].

    Attributes:
        failures: Readings that failed so far.
    """

    def __init__(self, bus: MotorBus, calibration: Calibration, *, rate_hz: float, patience_s: float) -> None:
        super().__init__(bus.clock)
        self.failures = 0
        self._bus, self._calibration = bus, calibration
        self._period_s, self._patience_s = 1.0 / rate_hz, patience_s
        self._turns: Floats | None = None
        self.start(f"gello-{calibration.serial}")

    def _release(self) -> None:
        self._bus.close()

    def _read_until_stopped(self) -> None:
        good_s = due_s = self._clock.monotonic_s()
        while not self._clock.wait(self._stop, max(0.0, due_s - self._clock.monotonic_s())):
            now_s = self._clock.monotonic_s()
            due_s = max(due_s + self._period_s, now_s)
            if self._read():
                good_s = self._clock.monotonic_s()
                continue
            self.failures += 1
            if self._clock.monotonic_s() - good_s > self._patience_s:
                self.fault = self._diagnosis()
                return

    def _read(self) -> bool:
        began_ns = self._clock.monotonic_ns()
        servos = self._bus.positions(self._calibration.ids)
        if servos is None:
            return False
        if self._turns is None:
            self._turns = self._calibration.turns(servos)
        capture_ns = (began_ns + self._clock.monotonic_ns()) // 2
        self.newest = Reading(capture_ns, self._calibration.values(servos, self._turns))
        return True

    def _diagnosis(self) -> str:
        """Return which servos are silent."""
        answering = self._bus.ping(self._calibration.ids)
        silent = [id_ for id_ in self._calibration.ids if id_ not in answering]
        leader = f"leader {self._calibration.serial}"
        if not silent:
            return f"{leader}: torn answers for {self._patience_s:g} s though every servo answers; see to the cables"
        if not answering:
            return f"{leader}: every servo is silent; see to its power and to the cable of the first"
        named = ", ".join(f"{id_} ({self._calibration.name_of(id_)})" for id_ in silent)
        return f"{leader}: servo {named} is silent; see to its cable and to the one before it"
