"""The loop of device servers, in virtual time, with a device that the test holds in its hand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from station.bus import codec, keys
from station.bus.client import Bus
from station.errors import StationError
from station.life.server import Life, ServerKind
from station.life.serving import serve
from station.operator import sample as readings
from station.operator.device import Device, DeviceError, Source
from station.operator.sample import OperatorSample
from station.operator.serve import serve_device
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.virtual.written import Log


class Wheel:
    """A device with one axis; the test turns it, tears it out and puts it back."""

    def __init__(self) -> None:
        self.turn: float | None = None
        self.capture_ns: int | None = None
        self.is_there = True
        self.tried = self.opened = self.closed = 0

    def open(self) -> Device:
        self.tried += 1
        if not self.is_there:
            raise DeviceError("no wheel; plug it in")
        self.opened += 1
        return self

    def read(self) -> OperatorSample | None:
        if not self.is_there:
            raise DeviceError("the wheel was torn out; plug it in")
        return None if self.turn is None else self.reading()

    def reading(self) -> OperatorSample:
        assert self.turn is not None
        return OperatorSample(capture_ns=self.capture_ns, controls={"wheel": self.turn}, joints=np.array([self.turn]))

    def why_silent(self) -> str:
        return "nobody turns the wheel"

    def facts(self) -> dict[str, Any]:
        return {"model": "wheel"}

    def close(self) -> None:
        self.closed += 1


class Nothing(msgspec.Struct):
    pass


class Station:
    """The server in a process of its own, and what it wrote."""

    def __init__(self, wheel: Wheel, network: Network) -> None:
        self.clock, self.log = network.clock, Log(network)
        self._address, self._wheel = network.address(), wheel
        self._life: Life | None = None
        self.code: int | None = None
        self._seen = 0  # events that were waited for, and those before them

    def _main(self, _config: Nothing, life: Life) -> int:
        self._life = life
        return serve_device(
            life,
            Source(
                open=self._wheel.open,
                also=lambda reading: {"also": codec.json_object(dict(reading.controls))},
                numbers=lambda: {"turned": self._wheel.turn},
            ),
            rate_hz=100.0,
            config={"size": 3},
            on_active=lambda: {"wound_up": True},
            punctual=lambda: "not in a test's own process",
        )

    def _serve(self) -> None:
        kind = ServerKind(name="wheel", role="sensor", summary="", config=Nothing, main=self._main)
        self.code = serve(kind, Nothing(), address=self._address)

    def start(self) -> None:
        self._process = self.clock.spawn(self._serve, "wheel")

    def stop(self) -> None:
        assert self._life is not None
        self._life.stop_event.set()
        self.clock.sleep(1.0)
        assert not self.clock.is_running(self._process)

    def until(self, name: str, reason: str = "", within_s: float = 5.0) -> float:
        """Wait for an event that comes after the one that was waited for before; return when it came [s]."""
        end_s = self.clock.monotonic_s() + within_s
        while self.clock.monotonic_s() < end_s:
            for number, (at_s, event) in enumerate(self.log.events()[self._seen :]):
                if (event.name, str(event.detail.get("reason", ""))) == (name, reason):
                    self._seen += number + 1
                    return at_s
            self.clock.sleep(0.005)
        raise AssertionError(f"no {name} {reason!r} within {within_s} s: {self.log.events()[self._seen :]}")

    def state(self) -> str:
        return codec.parse_struct(self.log.newest(keys.operator_status("wheel")), readings.Status).state


@pytest.fixture
def wheel() -> Wheel:
    return Wheel()


@pytest.fixture
def network() -> Iterator[Network]:
    with VirtualClock(1, late_ns=1_000_000) as clock:
        yield Network(clock, (20_000, 200_000))


@pytest.fixture
def station(wheel: Wheel, network: Network) -> Iterator[Station]:
    return Station(wheel, network)


def test_a_device_that_is_silent_from_the_start_is_lost_with_its_reason(station: Station) -> None:
    station.start()
    station.until("operator-lost", "nobody turns the wheel")
    station.clock.sleep(0.05)
    assert station.state() == "lost"


def test_samples_go_to_the_bus_with_what_the_server_adds(station: Station, wheel: Wheel) -> None:
    wheel.turn = 0.5
    station.start()
    station.until("operator-live")  # told before the tick that it is told of is written
    station.clock.sleep(0.05)
    assert station.state() == "live"
    assert codec.parse_json(station.log.newest("also")) == {"wheel": 0.5}
    assert codec.parse_f64(station.log.newest(keys.operator_joints("wheel"))).tolist() == [0.5]
    stated = codec.parse_json(station.log.newest(keys.server_config("wheel")))
    assert (stated["device"], stated["config"], stated["wound_up"]) == ({"model": "wheel"}, {"size": 3}, True)


def test_a_sample_that_is_given_twice_is_written_once(station: Station, wheel: Wheel) -> None:
    wheel.turn, wheel.capture_ns = 0.5, 1
    station.start()
    station.until("operator-lost", "nobody turns the wheel")
    station.clock.sleep(10.0)
    assert len(station.log.of(keys.operator_joints("wheel"))) == 1


def test_a_device_that_falls_silent_is_stale_then_lost_then_live_again(station: Station, wheel: Wheel) -> None:
    wheel.turn = 0.5
    station.start()
    station.until("operator-live")
    wheel.turn, gone_s = None, station.clock.monotonic_s()
    assert 0.1 < station.until("operator-stale", "no new sample for a moment") - gone_s + 0.011 < 0.13
    assert 1.0 < station.until("operator-lost", "nobody turns the wheel") - gone_s + 0.011 < 1.03
    wheel.turn, back_s = 0.6, station.clock.monotonic_s()
    assert 0.1 <= station.until("operator-live") - back_s < 0.13, "it must flow for a moment"


def test_a_device_that_is_torn_out_is_lost_at_once_and_looked_for_until_it_is_back(
    station: Station, wheel: Wheel
) -> None:
    wheel.turn = 0.5
    station.start()
    station.until("operator-live")
    wheel.is_there = False
    station.until("operator-lost", "the wheel was torn out; plug it in")
    assert wheel.closed == 1
    station.until("operator-lost", "no wheel; plug it in")
    station.clock.sleep(5.0)
    wheel.is_there = True
    station.until("operator-live")
    assert wheel.opened == 2
    assert 5 <= wheel.tried - 2 <= 7, "once a second, in six seconds"


def test_it_says_farewell_and_lets_go_of_the_device(station: Station, wheel: Wheel) -> None:
    wheel.turn = 0.5
    station.start()
    station.until("operator-live")
    station.stop()
    assert station.code == 0
    assert wheel.closed == 1
    status = codec.parse_struct(station.log.newest(keys.operator_status("wheel")), readings.Status)
    assert (status.state, status.reason) == ("lost", "the device server has ended")


def test_a_device_that_is_not_there_at_the_start_ends_the_server(wheel: Wheel, network: Network) -> None:
    def main(_config: Nothing, life: Life) -> int:
        return serve_device(life, Source(open=wheel.open), rate_hz=100.0, config={})

    wheel.is_there = False
    kind = ServerKind(name="wheel", role="sensor", summary="", config=Nothing, main=main)
    with pytest.raises(StationError, match="no wheel; plug it in"):
        serve(kind, Nothing(), address=network.address())
    with Bus(network.address(), name="test", timeout_s=5.0) as bus:
        assert bus.get(keys.operator_status("wheel")) is None
