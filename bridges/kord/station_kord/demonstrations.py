"""The ways in which a stream of targets brings a Kassow controller to a halt, each beside the setting that cures it.

Every demonstration runs the same code against the simulated controller twice, in exact virtual time, and differs in one
setting. docs/kassow.md tells the story of each.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station_kord.bridge import KordBridge
from station_kord.errors import NotConnected, Refused
from station_kord.options import TICK_S, Limits, SimOptions
from station_kord.profiles import PROFILES, Profile

_SPEED_RAD_S, _STANDS_RAD_S, _WINDOW_S = 0.3, 1e-4, 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """How one run went.

    Attributes:
        setting: What was set, as a user would write it.
        rows: One per tick, of `station_kord.state.TRACE`, all of the run.
        keys_s: From when to when the operator moved [s].
        buffer_len: How many moves may wait to be planned.
        event: What the controller said, in a line, or "".
        event_s: When, since the start [s]; None without an event.
    """

    setting: str
    rows: NDArray[Any]
    keys_s: tuple[float, float]
    buffer_len: int
    event: str = ""
    event_s: float | None = None

    @property
    def time_s(self) -> NDArray[np.float64]:
        """When each row was, since the start [s]."""
        return np.asarray((self.rows["tick"] - self.rows["tick"][0]) * TICK_S, dtype=np.float64)

    @property
    def sends(self) -> int:
        """Targets that were sent."""
        return int(self.rows["sent"].sum())

    @property
    def sends_per_s(self) -> NDArray[np.float64]:
        """Targets that were sent in the fifth of a second before each row, as a rate [1/s], shape (n,)."""
        total = np.concatenate([[0.0], np.cumsum(self.rows["sent"], dtype=np.float64)])
        ends = np.arange(1, len(total))
        begins = np.maximum(ends - round(_WINDOW_S / TICK_S), 0)
        return np.asarray((total[ends] - total[begins]) / _WINDOW_S, dtype=np.float64)

    @property
    def still_moves_s(self) -> float:
        """How long the arm went on after the operator had let go [s]."""
        moving = np.flatnonzero(np.abs(self.rows["qd"]).max(axis=1) > _STANDS_RAD_S)
        return max(0.0, float(self.time_s[moving[-1]]) - self.keys_s[1]) if len(moving) else 0.0


@dataclass(frozen=True, slots=True)
class Run:
    """A run to be made.

    Attributes:
        setting: What is set, as a user would write it.
        profile: How targets are tracked.
        sim: How controller and bridge behave.
    """

    setting: str
    profile: Profile
    sim: SimOptions


@dataclass(frozen=True, slots=True)
class Demonstration:
    """One failure and its cure.

    Attributes:
        name: On the command line.
        symptom: What an operator sees, in a sentence.
        cure: The setting that cures it, in a sentence.
        faulty, cured: The two runs.
        drive: Makes the operator's targets: tick to joint 1's way from the start [rad], or None for no new target.
        keys_s: From when to when the operator moves [s].
        ticks: How long to look.
    """

    name: str
    symptom: str
    cure: str
    faulty: Run
    cured: Run
    drive: Callable[[int], float | None]
    keys_s: tuple[float, float]
    ticks: int

    def run(self) -> tuple[Course, Course]:
        """Make both runs, the faulty one first."""
        return self._course(self.faulty), self._course(self.cured)

    def _course(self, run: Run) -> Course:
        limits = Limits(q_min=run.sim.q_min, q_max=run.sim.q_max, qd_max=(run.sim.qd_max_radps,) * 7,
                               qdd_max=(run.sim.qdd_max_radps2,) * 7)  # fmt: skip
        bridge = KordBridge(
            limits=limits, profile=run.profile, sim=run.sim, real_time_priority=0, trace_ticks=self.ticks + 100
        )
        with bridge:
            bridge.connect()
            first = bridge.get_state().tick
            start = bridge.engage()
            self._drive(bridge, start)
            rows = bridge.trace()
            events = bridge.get_state().events
        rows = rows[rows["tick"] >= first]
        if not events:
            return Course(run.setting, rows, self.keys_s, run.sim.buffer_len)
        event = events[0]
        told = f"{event.id}, {event.group}: {event.text}"
        return Course(run.setting, rows, self.keys_s, run.sim.buffer_len, told, (event.tick - first) * TICK_S)

    def _drive(self, bridge: KordBridge, start: NDArray[np.float64]) -> None:
        """Hand over targets until the time is over, or the session is."""
        for tick in range(self.ticks):
            way = self.drive(tick)
            try:
                if way is not None:
                    bridge.stream_j(start + np.array([way, 0, 0, 0, 0, 0, 0]))
                bridge.step(1)
            except NotConnected:
                return
            except Refused:  # faulted: the arm stands, and a real one's operator has noticed
                bridge.step(1)


def names() -> list[str]:
    """Return the demonstrations' names."""
    return list(_MAKERS)


def find(name: str) -> Demonstration:
    """Return a demonstration.

    Raises:
        KeyError: there is none of that name.
    """
    return _MAKERS[name]()


def _options(**changes: Any) -> SimOptions:
    return SimOptions(clock="virtual", **changes)


def _profile(name: str, **changes: Any) -> Profile:
    return dataclasses.replace(PROFILES[name], **changes)


def _ramp(begins_s: float, ends_s: float, *, every: int = 1) -> Callable[[int], float | None]:
    """Return who moves joint 1 at 0.3 rad/s for a time, with a new target on every so-manieth tick, and lets go."""

    def drive(tick: int) -> float | None:
        now_s = tick * TICK_S
        if not begins_s <= now_s < ends_s or tick % every:
            return None
        return _SPEED_RAD_S * (now_s - begins_s + TICK_S * every)

    return drive


def _fetch_first() -> Demonstration:
    profile = _profile("speed125")
    return Demonstration(
        name="fetch-first",
        symptom="The arm halts in the first moments of any motion: torque deviation.",
        cure="Send first: waitSync, then the command, then fetchData. The bridge has no other order.",
        faulty=Run("order: fetch-first", profile, _options(order="fetch-first")),
        cured=Run("order: send-first", profile, _options()),
        drive=_ramp(0.2, 1.2),
        keys_s=(0.2, 1.2),
        ticks=400,
    )


def _stop_point() -> Demonstration:
    return Demonstration(
        name="stop-point",
        symptom="The arm hardly moves while keys are pressed, and goes on for more than a minute after they are not.",
        cure="Let a new target replace the one before: overlay via-point. What is left are the 2 s of one target.",
        faulty=Run("overlay: stop-point", _profile("legacy-stop"), _options()),
        cured=Run("overlay: via-point", _profile("legacy-stop", overlay="via-point"), _options()),
        drive=_ramp(0.2, 0.6, every=2),
        keys_s=(0.2, 0.6),
        ticks=26_000,
    )


def _hold_flood() -> Demonstration:
    profile = _profile("time125", throttle=1)

    def drive(tick: int) -> float | None:
        return 0.001 if tick == 50 else None

    return Demonstration(
        name="hold-flood",
        symptom="Holding still, the controller suspends itself after three seconds: its buffer of moves is full.",
        cure="Send a target only when it has changed: the dirty flag.",
        faulty=Run("resend_targets: true", profile, _options(resend_targets=True)),
        cured=Run("resend_targets: false", profile, _options()),
        drive=drive,
        keys_s=(0.2, 0.204),
        ticks=1250,
    )


def _no_throttle() -> Demonstration:
    return Demonstration(
        name="no-throttle",
        symptom="In motion the controller suspends itself after a second or two: targets come faster than it plans.",
        cure="Send on every second tick: throttle 2.",
        faulty=Run("throttle: 1", _profile("speed125", throttle=1), _options()),
        cured=Run("throttle: 2", _profile("speed125"), _options()),
        drive=_ramp(0.2, 3.2),
        keys_s=(0.2, 3.2),
        ticks=1000,
    )


def _short_time() -> Demonstration:
    jump = 0.010  # rad; 8 ms allow 1.93 mrad from rest

    def drive(tick: int) -> float | None:
        return jump if tick == 50 else None

    return Demonstration(
        name="short-time",
        symptom="A first target that is 10 mrad away ends the connection: it cannot be reached in 8 ms.",
        cure="Go to a far target in steps that the time allows: the offset guard. Or ask for a speed (speed125).",
        faulty=Run("offset_guard: false", _profile("time250", offset_guard=False), _options()),
        cured=Run("offset_guard: true", _profile("time250"), _options()),
        drive=drive,
        keys_s=(0.2, 0.204),
        ticks=200,
    )


_MAKERS: dict[str, Callable[[], Demonstration]] = {
    "fetch-first": _fetch_first,
    "stop-point": _stop_point,
    "hold-flood": _hold_flood,
    "no-throttle": _no_throttle,
    "short-time": _short_time,
}
