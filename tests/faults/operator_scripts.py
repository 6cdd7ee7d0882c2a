"""What a fake operator does in a long session, for each device: engages and lets go over and over, moves the robot
meanwhile; three times the signal is lost. When the device's server dies is for whoever runs the session.

A cycle is 5.4 s: 3.4 s engaged, the motion in between. What is lost is lost 1.5 s after an engaging, for 1.5 s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

CYCLE_S, HELD_S, FIRST_S = 5.4, 3.4, 4.0
LOST_AFTER_S, LOST_FOR_S = 1.5, 1.5
LOSSES = 3

_MOVES_AFTER_S, _MOVES_FOR_S = 0.6, 2.0
_STICKS: tuple[dict[str, float], ...] = (
    {"left_stick_y": 0.8}, {"left_stick_y": -0.6}, {"right_stick_x": 0.7}, {"left_stick_x": 0.7},
    {"left_stick_y": 0.6, "right_stick_x": -0.5}, {"left_trigger": 1.0}, {"right_stick_y": -0.6},
    {"right_stick_y": 0.6}, {},
)  # fmt: skip
_TWISTS = ((0.5, 0, 0, 0, 0, 0), (-0.5, 0, 0, 0, 0, 0), (0, 0.5, 0, 0, 0, 0), (0, -0.5, 0, 0, 0, 0),
           (0, 0, 0.4, 0, 0, 0.4), (0, 0, -0.4, 0, 0, -0.4))  # fmt: skip
_KEYS = ("w", "s", "a", "d", "j", "l")
_HOME = (0.0, 0.4, 0.0, 1.2, 0.0, 0.0, 0.0, 0.0)
_REACHES = ((-0.5, 0.6, 0.3, 0.8, 0.0, 0.0, 0.2, 1.0), (-0.4, 0.5, -0.2, 0.9, 0.3, 0.0, 0.2, 1.0))

Steps = list[dict[str, Any]]


@dataclass(frozen=True)
class Plan:
    """The times of a session.

    Attributes:
        cycles: How often the operator engages.
        lossy: The cycles in which the signal is lost.
        fatal: The cycle in which the device's server dies.
    """

    cycles: int
    lossy: tuple[int, ...]
    fatal: int

    @classmethod
    def lasting(cls, minutes: float) -> Plan:
        """Spread what goes wrong evenly."""
        cycles = int(60.0 * minutes / CYCLE_S)
        every = max(cycles // (LOSSES + 2), 1)
        return cls(cycles, tuple(every * (number + 1) for number in range(LOSSES)), every * (LOSSES + 1))

    @property
    def end_s(self) -> float:
        """When the operator is done [s]."""
        return self.begin_s(self.cycles)

    def begin_s(self, cycle: int) -> float:
        """Return when the operator engages [s]."""
        return FIRST_S + cycle * CYCLE_S

    def begins_s(self) -> Iterator[tuple[int, float]]:
        """Yield every cycle with the time of its engaging [s]."""
        yield from ((cycle, self.begin_s(cycle)) for cycle in range(self.cycles))

    def losses_s(self) -> list[float]:
        """Return when the signal is lost [s]."""
        return [self.begin_s(cycle) + LOST_AFTER_S for cycle in self.lossy]


@dataclass(frozen=True)
class Session:
    """What the fakes of a runbook play.

    Attributes:
        scripts: A script for each server with a fake.
        engage: The control that drives while held; "" where the device has none, or another one's buttons count.
    """

    scripts: dict[str, dict[str, Any]]
    engage: str = ""


def _in_order(device: str, steps: Steps) -> dict[str, Any]:
    return {"device": device, "steps": sorted(steps, key=lambda step: float(step["at_s"]))}


def _unplugged(plan: Plan) -> Steps:
    return [
        {"at_s": at_s + late_s, "plugged": is_plugged}
        for at_s in plan.losses_s()
        for late_s, is_plugged in ((0.0, False), (LOST_FOR_S, True))
    ]


def pico(plan: Plan) -> Session:
    """Hands wave, sticks walk; the headset falls silent twice, and once its PC service dies."""
    controls: Steps = [{"at_s": 2.5, "press": "right_stick_click"}]  # the sticks walk
    for cycle, at_s in plan.begins_s():
        controls.append({"at_s": at_s, "set": {"left_grip": 1.0}, "for_s": HELD_S})
        if sticks := _STICKS[cycle % len(_STICKS)]:
            controls.append({"at_s": at_s + _MOVES_AFTER_S, "set": sticks, "for_s": _MOVES_FOR_S})
    kinds = ("silence", "silence", "crash")
    faults = [{"at_s": at_s, "kind": k, "for_s": LOST_FOR_S} for at_s, k in zip(plan.losses_s(), kinds, strict=True)]
    script = {"motion": "builtin:wave", "repeat": "swing", "controls": controls, "faults": faults}
    return Session({"pico": script}, engage="left_grip")


def gamepad(plan: Plan) -> Session:
    """The left bumper drives, sticks walk; the pad is torn out."""
    return Session({"gamepad": _in_order("gamepad", _bumper(plan) + _sticks(plan) + _unplugged(plan))})


def spacemouse(plan: Plan) -> Session:
    """A button drives, the cap moves a palm; the mouse is torn out."""
    steps = _unplugged(plan)
    for cycle, at_s in plan.begins_s():
        twist = _TWISTS[cycle % len(_TWISTS)]
        steps += [
            {"at_s": at_s, "buttons": [0]},
            {"at_s": at_s + _MOVES_AFTER_S, "twist": twist},
            {"at_s": at_s + _MOVES_AFTER_S + _MOVES_FOR_S, "twist": [0] * 6},
            {"at_s": at_s + HELD_S, "buttons": []},
        ]
    return Session({"spacemouse": _in_order("spacemouse", steps)}, engage="button_0")


def gello(plan: Plan) -> Session:
    """A gamepad's bumper drives, a leader reaches and comes home; its port goes twice, once a servo falls silent."""
    steps: Steps = [{"at_s": 0.0, "left": _HOME}]
    for cycle, at_s in plan.begins_s():
        reach = _REACHES[cycle % len(_REACHES)]
        for late_s, pose in ((_MOVES_AFTER_S, _HOME), (1.6, reach), (1.8, reach), (2.8, _HOME)):
            steps.append({"at_s": at_s + late_s, "left": pose})
    *gone, silent = plan.losses_s()
    for at_s in gone:
        steps += [{"at_s": at_s, "plugged": False}, {"at_s": at_s + LOST_FOR_S, "plugged": True}]
    steps += [{"at_s": silent, "silent": [4]}, {"at_s": silent + LOST_FOR_S, "silent": []}]
    return Session({"gello": _in_order("gello", steps), "gamepad": _in_order("gamepad", _bumper(plan))})


def keyboard(plan: Plan) -> Session:
    """Enter starts and pauses, keys walk; the terminal is closed. After a loss nothing is paused: nobody drives."""
    steps = _unplugged(plan)
    for cycle, at_s in plan.begins_s():
        steps += [
            {"at_s": at_s, "press": "enter"},
            {"at_s": at_s + _MOVES_AFTER_S, "press": _KEYS[cycle % len(_KEYS)], "for_s": _MOVES_FOR_S},
        ]
        if cycle not in (*plan.lossy, plan.fatal):
            steps.append({"at_s": at_s + HELD_S, "press": "enter"})
    return Session({"keyboard": _in_order("keyboard", steps)})


def _bumper(plan: Plan) -> Steps:
    return [
        {"at_s": at_s + late_s, "set": {"left_bumper": value}}
        for _, at_s in plan.begins_s()
        for late_s, value in ((0.0, 1), (HELD_S, 0))
    ]


def _sticks(plan: Plan) -> Steps:
    steps: Steps = []
    for cycle, at_s in plan.begins_s():
        sticks = _STICKS[cycle % len(_STICKS)]
        steps.append({"at_s": at_s + _MOVES_AFTER_S, "set": sticks})
        steps.append({"at_s": at_s + _MOVES_AFTER_S + _MOVES_FOR_S, "set": dict.fromkeys(sticks, 0.0)})
    return steps


SESSIONS: dict[str, Callable[[Plan], Session]] = {
    "pico": pico, "spacemouse": spacemouse, "gello": gello, "gamepad": gamepad, "keyboard": keyboard,
}  # fmt: skip
"""By device; the runbook is ``g1-sim-DEVICE``."""
