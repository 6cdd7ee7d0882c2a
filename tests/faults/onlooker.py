"""Sees every step of a G1 server on its bus, and keeps of each only what tells whether the robot was safe."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

import numpy as np

from adapters.robots.g1 import twist_keys
from station import registry
from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.tap import Tap, Write, open_tap
from station.contract import TIMING_STAGES
from station.errors import BusError
from station.life import events
from station.life.events import Event
from station.protocols import Floats
from station.rotations import tilt

ROBOT = twist_keys.TWIST2_ROBOT
FORMAT = registry.find("command", "twist2")
_RETRY_S = 0.05
_TICK_S = 0.1  # the gate lets no tick count for more
_SENSED, _OBSERVED = (2 + TIMING_STAGES.index(stage) for stage in ("state_read", "observed"))
_UNSEEN_S = 0.2  # after a longer silence, steps were made that nobody saw


class Step(NamedTuple):
    """One step of the robot's loop.

    Attributes:
        mono_ns: When its results were published [ns].
        writer: Source of its stamp: another one after a restart.
        gate: State of the gate.
        age_s: Age of the newest good command [s]; infinite for none.
        tilt_rad, height_m: Of the pelvis, as of the step's beginning.
        rate: Greatest rate of an element of the command since the step before, times what it may be.
        asks_to_stand: Whether the policy was asked to stand.
        damped: Whether the targets sent had no stiffness.
    """

    mono_ns: int
    writer: str
    gate: str
    age_s: float
    tilt_rad: float
    height_m: float
    rate: float
    asks_to_stand: bool
    damped: bool


class Onlooker:
    """Follows a bus from a thread, also when it is started anew on the same socket; a context manager."""

    def __init__(self, address: BusAddress) -> None:
        self.steps: list[Step] = []
        self.events: list[Event] = []
        self._address = address
        self._pose: Floats | None = None
        self._before: tuple[str, float, Floats] | None = None  # writer, instant and command of the step before
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="onlooker", daemon=True)
        self._thread.start()

    def since(self, mono_ns: int) -> list[Step]:
        """Return the steps that were published after an instant."""
        return [step for step in list(self.steps) if step.mono_ns > mono_ns]

    def gates(self, since_ns: int = 0) -> list[str]:
        """Return the states that the gate went through."""
        found: list[str] = []
        for step in self.since(since_ns):
            if found[-1:] != [step.gate]:
                found.append(step.gate)
        return found

    def named(self, name: str, since_ns: int = 0) -> list[Event]:
        """Return the events of a name that were written after an instant of the monotonic clock."""
        earliest_ns = time.time_ns() - (time.monotonic_ns() - since_ns)
        return [event for event in list(self.events) if event.name == name and event.wall_ns >= earliest_ns]

    def close(self) -> None:
        self._ended.set()
        self._thread.join()

    def __enter__(self) -> Onlooker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        tap: Tap | None = None
        while not self._ended.is_set():
            try:
                tap = tap or open_tap(self._address, backend="replication")
                self._take(tap.read(0.1))
            except BusError:
                if tap is not None:
                    tap.close()
                tap = None
                self._ended.wait(_RETRY_S)
        if tap is not None:
            tap.close()

    def _take(self, writes: list[Write]) -> None:
        newest: dict[str, Write] = {}
        for write in writes:
            if write.value is None:
                continue
            newest[write.key] = write
            if write.key == keys.sim_qpos(ROBOT):
                self._pose = codec.parse_f64(write.value)
            elif write.key == keys.EVENT:
                event = events.decode(write.value)
                self.events += [event] if event is not None else []
            elif write.key == keys.policy_timing(ROBOT):  # the last of a step's results
                self._see(newest)

    def _see(self, results: dict[str, Write]) -> None:
        wanted = [results.get(key(ROBOT)) for key in (keys.command_gate, keys.command_used, keys.target)]
        gate, used, target = (write.value if write is not None else None for write in wanted)
        mark = stamp.decode(results[keys.policy_timing(ROBOT)].stamp or b"")
        if gate is None or used is None or target is None or mark is None or self._pose is None:
            return
        said, command = codec.parse_json(gate), codec.parse_f64(used)
        timing = codec.parse_json_vector(results[keys.policy_timing(ROBOT)].value or b"")
        stiffness = np.array_split(codec.parse_f64(target), 3)[1]
        age_s = float("inf") if said["age_s"] is None else float(said["age_s"])
        rate = self._rate(mark.source, timing, command)
        self.steps.append(
            Step(mark.mono_ns, mark.source, said["state"], age_s, float(tilt(self._pose[3:7])), float(self._pose[2]),
                 rate, bool(np.array_equal(command, FORMAT.default)), not stiffness.any())
        )  # fmt: skip

    def _rate(self, writer: str, timing: Floats, command: Floats) -> float:
        """The gate looks at the clock between sensing and observing: this is the longest time that it may have seen."""
        before, self._before = self._before, (writer, timing[_SENSED], command)
        if before is None or before[0] != writer:
            return 0.0
        between_s = (timing[_OBSERVED] - before[1]) * 1e-9
        if between_s > _UNSEEN_S:
            return 0.0
        passed_s = min(max(between_s, 0.02), _TICK_S)
        return float(np.max(np.abs(command - before[2]) / (FORMAT.rate * passed_s)))
