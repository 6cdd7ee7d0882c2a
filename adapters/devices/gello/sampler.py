"""Reads one leader's servos in a thread of its own: a silent servo holds the library for 44 ms."""

from __future__ import annotations

import threading
from typing import NamedTuple

from adapters.devices.gello.bus import MotorBus, PortGone
from adapters.devices.gello.calibration import Calibration
from station.protocols import Floats

_STOP_S = 5.0


class Sample(NamedTuple):
    """One reading of all servos of a leader.

    Attributes:
        capture_ns: When it was read, on this machine's monotonic clock [ns].
        values: Joints [rad] and gripper (0..1), shape (n,).
    """

    capture_ns: int
    values: Floats


class Sampler:
    """The thread.

    Torn packets are read again. A servo that is silent for longer than `patience_s` is a fault with its name, and the
    end of the thread: what the joints were is never given in place of what they are.

    Args:
        bus: The servos' bus, which is this thread's from now on until `close`.
        calibration: Of the leader on it.
        rate_hz: Readings per second [Hz].
        patience_s: For how long a reading may fail [s].

    Attributes:
        newest: The newest reading; None before the first.
        fault: Why there will be no further one; "" while there will.
        failures: Readings that failed so far.
    """

    def __init__(self, bus: MotorBus, calibration: Calibration, *, rate_hz: float, patience_s: float) -> None:
        self.newest: Sample | None = None
        self.fault = ""
        self.failures = 0
        self._bus, self._calibration, self._clock = bus, calibration, bus.clock
        self._period_s, self._patience_s = 1.0 / rate_hz, patience_s
        self._turns: Floats | None = None
        self._stop = threading.Event()
        self._thread = self._clock.start(self._run, f"gello-{calibration.serial}")

    def close(self) -> None:
        """End the thread and release the bus; a second call does nothing."""
        self._stop.set()
        self._clock.join(self._thread, _STOP_S)
        self._bus.close()

    def _run(self) -> None:
        try:
            self._read_until_stopped()
        except PortGone as error:
            self.fault = str(error)

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
        self.newest = Sample(capture_ns, self._calibration.values(servos, self._turns))
        return True

    def _diagnosis(self) -> str:
        """Say which servos are silent."""
        answering = self._bus.ping(self._calibration.ids)
        silent = [id_ for id_ in self._calibration.ids if id_ not in answering]
        leader = f"leader {self._calibration.serial}"
        if not silent:
            return f"{leader}: torn answers for {self._patience_s:g} s though every servo answers; see to the cables"
        if not answering:
            return f"{leader}: every servo is silent; see to its power and to the cable of the first"
        named = ", ".join(f"{id_} ({self._calibration.name_of(id_)})" for id_ in silent)
        return f"{leader}: servo {named} is silent; see to its cable and to the one before it"
