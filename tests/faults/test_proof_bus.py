"""The robot holds at once when the bus is gone, and servers that lose it together tell of one interruption."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

from station.bus.address import BusAddress
from station.control.gate import GateConfig
from station.episode.quality.findings import Quality
from tests.faults.bus_station import of_kind
from tests.faults.bus_trials import cut_every_connection, freeze_the_bus, kill_the_bus_twice
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time

HOLDS_S = GateConfig().return_after_s - GateConfig().hold_after_s
TOGETHER_S = 0.5  # what servers tell within it is one interruption


def test_frozen_for_two_seconds_the_robot_holds_before_it_returns(
    bus_server: BusAddress, tmp_path: Path, proof: Figures
) -> None:
    def freeze() -> None:
        with Waits.watched() as waits:
            changes = freeze_the_bus(bus_server, Path(mkdtemp(dir=tmp_path)), 2.0)
        if ("tracking", "returning") in changes and ("holding", "returning") not in changes:
            raise TooLate(f"a step that holds: {changes}", HOLDS_S, waits.longest_s)
        assert ("holding", "returning") in changes

    in_time(freeze)


def expect_told_together(quality: Quality, times: int, waits: Waits) -> None:
    """A server that notices half a second after the others tells of a loss of its own."""
    if (told := len(of_kind(quality, "bus-lost"))) > times:
        raise TooLate(f"{times} losses were told as {told}", TOGETHER_S / 2, waits.longest_s)


def test_a_killed_bus_is_one_interruption_for_all(processes: None, tmp_path: Path, proof: Figures) -> None:
    def kill() -> None:
        with Waits.watched() as waits:
            quality = kill_the_bus_twice(Path(mkdtemp(dir=tmp_path)))
        expect_told_together(quality, 2, waits)
        away_s = max(found.seconds or 0.0 for found in of_kind(quality, "bus-lost"))
        hole_s = max(found.seconds or 0.0 for found in of_kind(quality, "hole"))
        proof.figure("bus `kill -9`: away, as servers measured it", away_s, "s")
        proof.figure("bus `kill -9`: hole in the recording", hole_s, "s")

    in_time(kill)


def test_connections_that_are_cut_are_one_interruption(bus_server: BusAddress, tmp_path: Path, proof: Figures) -> None:
    def cut() -> None:
        with Waits.watched() as waits:
            quality = cut_every_connection(bus_server, Path(mkdtemp(dir=tmp_path)))
        expect_told_together(quality, 1, waits)

    in_time(cut)
