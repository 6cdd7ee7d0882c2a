"""One fault of what commands or moves a robot, in the middle of a motion: what the robot did, as figures."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from random import Random
from typing import Any, Literal

import msgspec

from station.assets import inventory
from tests.faults.bus_station import pause
from tests.faults.moving_station import MovingStation
from tests.faults.onlooker import Step
from tests.waiting import wait_until

Kind = Literal["kill", "freeze", "cut", "bus", "g1"]
KINDS: tuple[Kind, ...] = ("kill", "freeze", "cut", "bus", "g1")

DULL = ("builtin:stand", "builtin:tour")  # in one nothing moves, the other is all of them
CLIPS = tuple(name for name in inventory.motions() if name.startswith("builtin:") and name not in DULL)
STANDS_S = 2.0  # watched after it is back at standing


def expect_safe(trial: Trial, hold_after_s: float, told: str) -> None:
    """What holds of a lost command whatever the machine is busy with.

    Args:
        trial: What the robot did.
        hold_after_s: Of its gate [s].
        told: How to do it again.
    """
    assert trial.used_age_s <= hold_after_s + 1e-6, f"no older command is followed; {told}"
    assert trial.stands, f"back at standing it is asked to stand; {told}"
    assert trial.gates_after[-2:] == ("entering", "tracking"), f"another takes over with the blend; {told}"
    assert trial.rate <= 1.05, f"the command is continuous; {told}"
    assert trial.falls == 0, told


class Trial(msgspec.Struct, kw_only=True):
    """What a fault led to.

    Attributes:
        kind, clip, into_s: What was done, in which motion, how long after it was first followed [s].
        away_s: How long the bus or the robot's server was away [s].
        used_age_s: Greatest age of a command that was followed [s].
        hold_age_s, hold_s: Age of the command in the first step that held it; from the fault to that step [s].
        default_s: From the last good command to standing [s].
        entered_s: From the end of the fault until the command was followed again [s].
        gates: States of the gate from the fault until it stands.
        gates_after: And from the end of the fault until the command was followed again.
        stands: Whether the policy was asked to stand, and nothing else, from then on.
        falls, lean_deg, lowest_m: From the fault to the end of the trial.
        rate: Greatest rate of an element of the command in that time, times what it may be.
    """

    kind: Kind
    clip: str
    into_s: float
    away_s: float = 0.0
    used_age_s: float = math.nan
    hold_age_s: float = math.nan
    hold_s: float = math.nan
    default_s: float = math.nan
    entered_s: float = math.nan
    gates: tuple[str, ...] = ()
    gates_after: tuple[str, ...] = ()
    stands: bool = False
    falls: int = 0
    lean_deg: float = math.nan
    lowest_m: float = math.nan
    rate: float = math.nan


def random_trial(
    station: MovingStation,
    kind: Kind,
    random: Random,
    within_s: float = 6.0,
    clips: Sequence[str] = CLIPS,
    **motion: Any,
) -> Trial:
    """Play a random clip, do it at a random moment, let it end, and see that the robot follows again.

    Args:
        station: In which it is done.
        kind: What is done.
        random: Which clip, when, and for how long.
        within_s: Latest moment, after the clip was first followed [s].
        clips: To choose from.
        motion: Settings of the motion server beside the clip.
    """
    trial = Trial(kind=kind, clip=random.choice(clips), into_s=random.uniform(0.5, within_s))
    station.play(trial.clip, **motion)
    station.wait_s(trial.into_s)
    at_ns = time.monotonic_ns()
    {"bus": _lose_bus, "g1": _lose_robot}.get(kind, _lose_command)(station, trial, random)
    station.wait_s(1.0)
    trial.falls += station.falls(at_ns)
    trial.lean_deg, trial.lowest_m = station.worst_lean_deg(at_ns), station.lowest_m(at_ns)
    trial.rate = max(step.rate for step in station.onlooker.since(at_ns))
    station.end_motion()
    return trial


def _lose_command(station: MovingStation, trial: Trial, _random: Random) -> None:
    def again() -> None:
        station.start_again("motion")

    ways: dict[str, tuple[Callable[[], int], Callable[[], object]]] = {
        "kill": (lambda: station.kill("motion"), again),
        "freeze": (lambda: station.freeze("motion"), lambda: station.thaw("motion")),
        "cut": (station.cut, station.mend),
    }
    fault, end = ways[trial.kind]
    at_ns = fault()
    station.wait_for_gate("waiting", at_ns)
    station.wait_s(STANDS_S)
    _measure(trial, station.onlooker.since(at_ns), at_ns)
    trial.gates = tuple(station.onlooker.gates(at_ns))
    _follow_again(station, trial, end)


def _lose_bus(station: MovingStation, trial: Trial, random: Random) -> None:
    trial.away_s = random.uniform(0.05, 4.0)
    before = station.log("g1")
    station.kill_bus()
    pause(trial.away_s)
    _follow_again(station, trial, station.start_bus)
    trial.falls += "fall " in station.log("g1").removeprefix(before)


def _lose_robot(station: MovingStation, trial: Trial, random: Random) -> None:
    trial.away_s = random.uniform(0.0, 2.0)
    station.kill("g1")
    pause(trial.away_s)
    _follow_again(station, trial, lambda: station.start_again("g1"))


def _follow_again(station: MovingStation, trial: Trial, end: Callable[[], object]) -> None:
    since_ns = time.monotonic_ns()
    end()
    wait_until(lambda: _has_entered(station, since_ns), 60.0)
    tracked = next(step for step in station.onlooker.since(since_ns) if step.gate == "tracking")
    trial.entered_s = (tracked.mono_ns - since_ns) * 1e-9
    gates = station.onlooker.gates(since_ns)
    trial.gates_after = tuple(gates[: gates.index("tracking") + 1])


def _has_entered(station: MovingStation, since_ns: int) -> bool:
    return any(step.gate == "tracking" for step in station.onlooker.since(since_ns))


def _measure(trial: Trial, steps: list[Step], at_ns: int) -> None:
    followed = [step for step in steps if step.gate in ("entering", "tracking")]
    held = next((step for step in steps if step.gate == "holding"), None)
    stands = next(step for step in steps if step.gate == "waiting")
    trial.used_age_s = max((step.age_s for step in followed), default=0.0)
    if held is not None:  # the loop may have been late for it
        trial.hold_age_s, trial.hold_s = held.age_s, (held.mono_ns - at_ns) * 1e-9
    trial.stands = all(step.asks_to_stand for step in steps if step.mono_ns >= stands.mono_ns)
    trial.default_s = stands.age_s  # nothing good has come since
