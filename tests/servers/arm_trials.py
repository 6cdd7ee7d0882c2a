"""An operator with a spacemouse moves an arm: its tool, then a joint, and lets go."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from adapters.robots.kassow.kinematics import KR810
from station.bus import codec, keys
from station.life import events
from tests.servers.operated_arm import ROBOT, OperatedArm
from tests.waiting import wait_until

SPEED_RAD_S, RATE_HZ = 0.3, 250.0
FORWARDS_M, TURNED_RAD = 0.08, 0.2
CYCLE_S, CYCLES = 7.0, 8
RESTS = 450
"""Commands since the operator let go: the arm has come to rest, and the cap was pushed for a while."""

_REST = [0, 0, 0, 0, 0, 0]


def press(at_s: float, for_s: float = 0.4) -> list[dict[str, Any]]:
    return [{"at_s": at_s, "buttons": [0]}, {"at_s": at_s + for_s, "buttons": []}]


def push(at_s: float, twist: list[float], for_s: float) -> list[dict[str, Any]]:
    return [{"at_s": at_s, "twist": twist}, {"at_s": at_s + for_s, "twist": _REST}]


def _cycle(at_s: float) -> list[dict[str, Any]]:
    """Engage, push the tool forwards, choose joints, turn the base, let go, and push the cap all the same."""
    return [
        *press(at_s + 0.5), *push(at_s + 1.0, [1, 0, 0, 0, 0, 0], 1.0), *press(at_s + 2.1, 1.4),
        *push(at_s + 3.7, [0, 0, 0, 0, 0, 1], 1.0), *press(at_s + 5.0), *push(at_s + 5.5, [1, 1, 1, 1, 1, 1], 1.0),
    ]  # fmt: skip


def press_and_push(twist: list[float]) -> list[dict[str, Any]]:
    """Press and push the cap, again and again: where a sample came late and driving ended, the next press begins it."""
    begin_s = [4.0 * cycle for cycle in range(30)]
    return [step for at_s in begin_s for step in (*press(at_s + 0.5), *push(at_s + 1.0, twist, 2.0))]


def move_and_let_go(folder: Path) -> list[str]:
    """Do so, again where a sample came late and driving ended by itself; return why driving ended each time."""
    steps = [step for cycle in range(CYCLES) for step in _cycle(cycle * CYCLE_S)]
    with OperatedArm(folder, steps) as station:
        arm = station.start_arm()
        started = arm.session.q.copy()
        station.start_script()
        rest = Rest([], [], [])

        def is_done() -> bool:
            nonlocal rest  # the script goes on, and the operator drives again
            rest = since_release(station)
            return len(rest.commands) > RESTS and rest.has_arrived() and has_moved(station, started)

        wait_until(is_done, CYCLES * CYCLE_S + 60.0)
        last = rest.commands[-1]
        assert (np.array(rest.commands[RESTS // 2 :]) == last).all(), "it stays where it is, however the cap is pushed"
        assert {(source["driver"], source["engaged"]) for source in rest.sources} == {("arm-tcp", False)}
        commands = station.commands()
        assert commands[0] == pytest.approx(started, abs=1e-6)
        for driven in since_each_press(station):
            assert np.abs(np.diff(driven, axis=0)).max(initial=0.0) <= SPEED_RAD_S / RATE_HZ + 1e-9
        assert station.told("operator-mode")[0].detail["mode"] == "joints 1-4"
        assert not station.log.values(twist_keys.T_ACTION)  # of stock readers, which there are none for an arm
        return [str(event.detail["reason"]) for event in station.told("operator-disengaged")]


def has_moved(station: OperatedArm, started: np.ndarray[Any, Any]) -> bool:
    """Whether the tool went forwards, and the base turned."""
    commands = station.commands()
    moved = np.array([KR810.posture(q).position for q in commands[::25]])
    return bool(moved[:, 0].max() - moved[0, 0] > FORWARDS_M and commands[:, 0].max() - started[0] > TURNED_RAD)


def since_each_press(station: OperatedArm) -> list[np.ndarray[Any, Any]]:
    """Return the commands, shape (n, 7) [rad] each, from each engaging to the next, which begins where the arm stands:
    that is behind the last command, where the arm did not follow any more."""
    found: list[list[Any]] = [[]]
    for write in list(station.log.writes):
        if write.key == keys.EVENT and (event := events.decode(write.value or b"")) is not None:
            if event.name == "operator-engaged":
                found.append([])
        elif write.key == keys.action_joints(ROBOT) and write.value:
            found[-1].append(codec.parse_json(write.value))
    assert not found[0], "nobody has engaged yet"
    return [np.array(driven).reshape(-1, 7) for driven in found[1:]]


class Rest(NamedTuple):
    """What was written since the operator let go: commands and states of the joints, shape (7,) each, and where the
    commands come from."""

    commands: list[np.ndarray[Any, Any]]
    states: list[np.ndarray[Any, Any]]
    sources: list[dict[str, Any]]

    def has_arrived(self) -> bool:
        """Whether the arm stands where it was asked to be last; on a busy machine it comes there late."""
        return bool(self.states) and np.allclose(self.states[-1], self.commands[-1], rtol=0.0, atol=1e-9)


def since_release(station: OperatedArm) -> Rest:
    """Return what was written since the operator let go; nothing while it drives, or was made to let go."""
    found = Rest([], [], [])
    for write in reversed(list(station.log.writes)):
        if write.key == keys.EVENT and (event := events.decode(write.value or b"")) is not None:
            if event.name == "operator-disengaged" and event.detail["reason"] == "released":
                return Rest(found.commands[::-1], found.states[::-1], found.sources[::-1])
            if event.name in ("operator-engaged", "operator-disengaged"):
                break
        elif write.key == keys.action_joints(ROBOT) and write.value:
            found.commands.append(np.array(codec.parse_json(write.value)))
        elif write.key == keys.state_joints(ROBOT) and write.value:
            found.states.append(codec.parse_f64(write.value)[:7])
        elif write.key == keys.command_source(ROBOT) and write.value:
            found.sources.append(codec.parse_json(write.value))
    return Rest([], [], [])
