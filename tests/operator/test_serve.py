"""The loop of device servers, on a real bus, with a device that the test holds in its hand."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import Tap, open_tap
from station.errors import StationError
from station.life import events
from station.life.server import Life, ServerKind
from station.life.serving import serve
from station.operator import reading as readings
from station.operator.device import Device, DeviceError
from station.operator.reading import Reading
from station.operator.serve import serve_device
from tests.waiting import wait_until


class Wheel:
    """A device with one axis; the test turns it, tears it out and puts it back."""

    def __init__(self) -> None:
        self.turn: float | None = None
        self.capture_ns: int | None = None
        self.is_there = True
        self.opened = self.closed = 0

    def open(self) -> Device:
        if not self.is_there:
            raise DeviceError("no wheel; plug it in")
        self.opened += 1
        return self

    def read(self) -> Reading | None:
        if not self.is_there:
            raise DeviceError("the wheel was torn out; plug it in")
        return None if self.turn is None else self.reading()

    def reading(self) -> Reading:
        assert self.turn is not None
        return Reading(capture_ns=self.capture_ns, controls={"wheel": self.turn}, joints=np.array([self.turn]))

    def why_silent(self) -> str:
        return "nobody turns the wheel"

    def facts(self) -> dict[str, Any]:
        return {"model": "wheel"}

    def close(self) -> None:
        self.closed += 1


class Nothing(msgspec.Struct):
    pass


class Station:
    """The server in a thread, and what it wrote."""

    def __init__(self, wheel: Wheel, address: BusAddress, tap: Tap) -> None:
        self._address, self._tap, self._wheel = address, tap, wheel
        self._life: Life | None = None
        self.events: list[events.Event] = []
        self.values: dict[str, bytes] = {}
        self.writes: list[str] = []  # of samples
        self.code: int | None = None
        self._seen = 0  # events that were waited for, and those before them
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def _main(self, _config: Nothing, life: Life) -> int:
        self._life = life
        return serve_device(
            life,
            self._wheel.open,
            rate_hz=100.0,
            config={"size": 3},
            also=lambda reading: {"also": codec.json_object(dict(reading.controls))},
            on_active=lambda: {"wound_up": True},
            punctual=lambda: "not in a test's own process",
        )

    def _serve(self) -> None:
        kind = ServerKind(name="wheel", role="sensor", summary="", config=Nothing, main=self._main)
        self.code = serve(kind, Nothing(), address=self._address)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        if self._life is not None:
            self._life.stop_event.set()
        self._thread.join(30.0)
        self.take()

    def take(self) -> None:
        for write in self._tap.read(0.02):
            self.values[write.key] = write.value or b""
            self.writes += [write.key] if write.key == keys.operator_joints("wheel") else []
            event = events.decode(write.value or b"") if write.key == keys.EVENT else None
            self.events += [event] if event is not None else []

    def until(self, name: str, reason: str = "") -> None:
        """Wait for an event that comes after the one that was waited for before, whatever was told between them."""

        def found() -> bool:
            self.take()
            told = [(event.name, str(event.detail.get("reason", ""))) for event in self.events[self._seen :]]
            self._seen += told.index((name, reason)) + 1 if (name, reason) in told else 0
            return (name, reason) in told

        wait_until(found)

    def state(self) -> str:
        self.take()
        return codec.parse_struct(self.values[keys.operator_status("wheel")], readings.Status).state


@pytest.fixture
def wheel() -> Wheel:
    return Wheel()


@pytest.fixture
def station(wheel: Wheel, bus_server: BusAddress) -> Iterator[Station]:
    tap = open_tap(bus_server)
    station = Station(wheel, bus_server, tap)
    yield station
    station.stop()
    tap.close()


def test_a_device_that_is_silent_from_the_start_is_lost_with_its_reason(station: Station) -> None:
    station.start()
    station.until("operator-lost", "nobody turns the wheel")
    wait_until(lambda: station.state() == "lost")


def test_samples_go_to_the_bus_with_what_the_server_adds(station: Station, wheel: Wheel) -> None:
    wheel.turn = 0.5
    station.start()
    station.until("operator-live")  # told before the tick that it is told of is written
    wait_until(lambda: station.state() == "live")
    assert codec.parse_json(station.values["also"]) == {"wheel": 0.5}
    assert codec.parse_f64(station.values[keys.operator_joints("wheel")]).tolist() == [0.5]
    stated = codec.parse_json(station.values[keys.server_config("wheel")])
    assert (stated["device"], stated["config"], stated["wound_up"]) == ({"model": "wheel"}, {"size": 3}, True)


def test_a_sample_that_is_given_twice_is_written_once(station: Station, wheel: Wheel) -> None:
    wheel.turn, wheel.capture_ns = 0.5, 1
    station.start()
    station.until("operator-lost", "nobody turns the wheel")
    assert station.writes == [keys.operator_joints("wheel")]


def test_a_device_that_falls_silent_is_stale_then_lost_then_live_again(station: Station, wheel: Wheel) -> None:
    wheel.turn = 0.5
    station.start()
    station.until("operator-live")
    wheel.turn = None
    station.until("operator-stale", "no new sample for a moment")
    station.until("operator-lost", "nobody turns the wheel")
    wheel.turn = 0.6
    station.until("operator-live")


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
    wheel.is_there = True
    station.until("operator-live")
    assert wheel.opened == 2


def test_it_says_farewell_and_lets_go_of_the_device(station: Station, wheel: Wheel) -> None:
    wheel.turn = 0.5
    station.start()
    station.until("operator-live")
    station.stop()
    assert station.code == 0
    assert wheel.closed == 1
    status = codec.parse_struct(station.values[keys.operator_status("wheel")], readings.Status)
    assert (status.state, status.reason) == ("lost", "the device server has ended")


def test_a_device_that_is_not_there_at_the_start_ends_the_server(wheel: Wheel, bus_server: BusAddress) -> None:
    def main(_config: Nothing, life: Life) -> int:
        return serve_device(life, wheel.open, rate_hz=100.0, config={})

    wheel.is_there = False
    kind = ServerKind(name="wheel", role="sensor", summary="", config=Nothing, main=main)
    with pytest.raises(StationError, match="no wheel; plug it in"):
        serve(kind, Nothing(), address=bus_server)
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        assert bus.get(keys.operator_status("wheel")) is None
