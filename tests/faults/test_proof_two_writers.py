"""A second commander is told of at once, and the first is followed through it without a single step of holding."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from station.bus.address import BusAddress
from station.control.gate import GateConfig
from tests.faults.rivals import refuse_a_stranger, refuse_ours, refuse_the_second
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.servers.g1_station import LIGHT

HOLD_S = GateConfig().hold_after_s
SOON = 10  # writes of a 50 Hz commander in 200 ms
PERIOD_S = 0.02


def expect_followed(lost: list[tuple[str, str]], waits: Waits) -> None:
    """The gate has not changed but where the one that was followed fell silent: the machine was late."""
    if lost:
        raise TooLate(f"the commands of the writer that is obeyed: {lost}", HOLD_S / 2, waits.longest_s)


def test_a_second_motion_server_is_told_of_within_ten_of_its_writes(bus_server: BusAddress, proof: Figures) -> None:
    def refuse() -> int:
        with Waits.watched() as waits:
            lost, heard = refuse_the_second(bus_server, *LIGHT)
        expect_followed(lost, waits)
        if heard > SOON:
            raise TooLate(f"told of the second after {heard} of its writes", (heard - SOON) * PERIOD_S, waits.longest_s)
        return heard

    proof.figure("a second commander is told of after", in_time(refuse), "writes", limit=f"{SOON}, 200 ms")


@pytest.mark.parametrize("refuse", [refuse_a_stranger, refuse_ours])
def test_the_writer_that_is_obeyed_is_followed_without_a_break(
    refuse: Callable[..., list[tuple[str, str]]], bus_server: BusAddress, proof: Figures
) -> None:
    def once() -> None:
        with Waits.watched() as waits:
            lost = refuse(bus_server, *LIGHT)
        expect_followed(lost, waits)

    in_time(once)
