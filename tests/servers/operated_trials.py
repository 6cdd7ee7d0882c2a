"""An operator with a headset drives the simulated G1: what is told, and what the robot does."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from station import registry
from station.control.gate import GateConfig
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from station.operator.buttons import HOLD_S
from station.protocols import Floats
from tests.servers.operated_station import PATIENT, TIMEOUT_S, OperatedStation
from tests.waiting import wait_until

FORMAT = registry.find("command", "twist2")
X, Y, B = "left_primary", "left_secondary", "right_secondary"
SAME = 1e-6
ANSWERED_S = 25.0
"""By then what was asked of the recorder is answered, or told as refused: who presses sooner asks for the opposite."""
_OF_DRIVING = [f"operator-{what}" for what in ("engaged", "disengaged", "mode", "exit", "refused")]


class Driven(NamedTuple):
    """What came of driving.

    Attributes:
        told: Names of what was told of it without ``operator-``, with the reason where there is one.
        followed: Share of the robot's steps, from the first in which it followed, in which it did.
    """

    told: list[tuple[str, str]]
    followed: float

    @property
    def by_the_operator(self) -> list[str]:
        """What was told, but for samples that came late, as they do on a busy machine: driving ends and is begun
        anew."""
        found, lost = [], False
        for name, reason in self.told:
            if is_of_the_device(reason):
                lost |= name == "disengaged"
            elif lost and name == "engaged":
                lost = False
            else:
                found.append(name)
        return found

    @property
    def losses(self) -> list[str]:
        """Why driving ended each time that samples came late."""
        return [reason for name, reason in self.told if name == "disengaged" and is_of_the_device(reason)]


_OF_LATENESS = ("pico is ", " jumped ", "samples of pico come ", "the robot's server is silent", "the bus is lost")


def is_of_the_device(reason: str) -> bool:
    """Whether a reason is that samples, or the robot's own words, came late."""
    return any(words in reason for words in _OF_LATENESS)


def _driven(station: OperatedStation) -> Driven:
    events = station.told(*_OF_DRIVING)
    told = [(event.name.removeprefix("operator-"), str(event.detail.get("reason", ""))) for event in events]
    states = station.log.states()
    followed = states[states.index("tracking") :]
    return Driven(told, followed.count("tracking") / len(followed))


def wave_walk_and_leave(folder: Path, gate: GateConfig = PATIENT) -> Driven:
    """Engage, let go, wave, walk, let go and leave."""
    with OperatedStation(folder, gate=gate) as station:
        assert station.log.gate()["state"] == "waiting"
        station.drive_until(lambda: station.log.gate()["state"] == "tracking")
        station.let_go()
        station.drive_until(lambda: np.ptp(vectors(station)[:, 6:], axis=0).max() > 0.2)  # it waves
        station.press("right_stick_click", until=lambda: station.told("operator-mode"))
        station.worn.hold({"left_stick_y": 0.8})
        station.drive_until(lambda: vectors(station)[:, 0].max() > 0.3)  # and walks
        station.worn.let_go()
        station.let_go()
        station.press(X, until=lambda: station.told("operator-exit"))
        assert station.wait_for_end() == 0
        jumps = station.restarts_at_engaging()
        assert len(jumps) == len(station.told("operator-engaged"))
        assert max(jumps) <= SAME
        wait_until(
            lambda: np.abs(vectors(station)[-1] - FORMAT.default).max() <= SAME
        )  # the log may be a moment behind
        change = np.abs(np.diff(vectors(station), axis=0)) / (FORMAT.rate * 0.02)
        assert change.max() <= 1.0 + SAME
        assert station.is_upright()
        states = station.log.states()
        assert set(states[states.index("tracking") :]) <= {"tracking", "holding", "returning", "waiting"}
        return _driven(station)


def vectors(station: OperatedStation) -> Floats:
    """All commands so far, shape (n, 35)."""
    return np.array([vector for _, vector in station.commands()])


def be_silent_and_crash(folder: Path, gate: GateConfig = PATIENT) -> Driven:
    """Lose the headset for a moment, by a crash of its server, and for good; drive anew after each."""
    with OperatedStation(folder, gate=gate, patience_s=2.0) as station:
        station.drive_until(lambda: station.log.gate()["state"] == "tracking")
        count = len(station.told("operator-disengaged"))
        station.worn.be_silent(1.0)
        station.wait_for("operator-disengaged", count + 1)
        expect_nobody_drives(station)
        station.engage()
        died = len(station.told("server-restarted", "server-died"))
        station.worn.poison()
        wait_until(lambda: len(station.told("server-restarted", "server-died")) > died, TIMEOUT_S)
        expect_nobody_drives(station)  # the library took the server down with it, and it is there again
        station.engage()
        station.worn.be_silent(4.0)
        wait_until(lambda: "pico has been away" in str(station.told("teleop-commands-end")), TIMEOUT_S)
        station.wait_for_gate("waiting")
        expect_nobody_drives(station)
        station.drive_until(lambda: station.log.gate()["state"] == "tracking")
        assert all(is_of_the_device(reason) for reason in station.reasons())
        jumps = station.restarts_at_engaging()
        assert len(jumps) == len(station.told("operator-engaged"))
        assert max(jumps) <= SAME
        assert station.is_upright()
        return _driven(station)


def expect_nobody_drives(station: OperatedStation) -> None:
    """The device is live again, and that alone moves nothing."""
    count = len(station.told("operator-engaged"))
    station.wait_until_live()
    assert len(station.told("operator-engaged")) == count
    assert not station.is_engaged


def record_and_begin_anew(folder: Path, gate: GateConfig = PATIENT) -> Quality:
    """Record, mark, discard and record again by buttons; return what `check` finds in the second episode."""
    with OperatedStation(folder, gate=gate, record=True, task="wave", operator="ada") as station:
        station.press(Y, until=lambda: station.told("record-start"), again_s=ANSWERED_S)
        station.engage()
        station.press(B, until=lambda: station.told("mark"))
        begun_anew = HOLD_S + 0.6
        station.press(B, until=lambda: len(station.told("record-start")) == 2, for_s=begun_anew, again_s=2 * ANSWERED_S)
        assert len(station.told("record-stop")) == 1
        marks = len(station.told("mark"))
        station.press(B, until=lambda: len(station.told("mark")) > marks)
        station.drive_until(lambda: station.log.gate()["state"] == "tracking")
        station.press(Y, until=lambda: len(station.told("record-stop")) == 2, again_s=ANSWERED_S)
        assert not station.told("operator-record-refused")
        first, second = sorted((station.data / "wave").iterdir())
    assert check(open_episode(first)).discarded
    quality = check(open_episode(second))
    assert not quality.discarded
    return quality
