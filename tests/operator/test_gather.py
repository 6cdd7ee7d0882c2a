"""Waiting for an operator's sample, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from station.bus.client import Bus
from station.errors import NotReady
from station.operator.gather import Gatherer
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    with VirtualClock() as made:
        yield made


def test_what_lasts_is_told_once_and_where_nothing_comes_in_time_the_reason_is_said(clock: VirtualClock) -> None:
    told: list[tuple[float, str]] = []
    looks = 0

    def look() -> None:
        nonlocal looks
        looks += 1

    began_s = clock.monotonic_s()
    with Bus(Network(clock).address(), name="calibrate") as bus, Gatherer(bus, "pico") as gatherer:
        with pytest.raises(NotReady, match=r"^pico: nothing to measure within 30 s: (?P<why>.+)$") as refused:
            gatherer.wait_for(
                lambda _reading: "", 30.0, lambda why: told.append((clock.monotonic_s() - began_s, why)), look
            )
        assert clock.monotonic_s() - began_s == pytest.approx(30.0, abs=1.0)
        with pytest.raises(NotReady, match=r"^pico: no sample came within 5 s: "):
            gatherer.gather(lambda _reading: "", 5.0)
    assert clock.monotonic_s() - began_s == pytest.approx(35.0, abs=1.0)
    ((told_s, why),) = told
    assert 0.0 < told_s < 5.0
    assert str(refused.value).endswith(why)
    assert looks > 30, "the device's process is looked at all the while"
