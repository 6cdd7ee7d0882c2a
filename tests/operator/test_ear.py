"""What is heard of an operator's device, on a real bus: the test plays the device servers."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.operator import reading as readings
from station.operator.ear import STALE_S, Ear, Heard
from station.operator.reading import Reading, Status
from tests.waiting import wait_until


class Devices:
    """Device servers that say what they are told to, and who listens to them."""

    def __init__(self, bus: Bus, device: str, controls_from: str = "") -> None:
        self.bus, self.counts = bus, dict.fromkeys((device, controls_from), 0)
        self.watch = bus.watch(Ear.watched(device, controls_from))
        self.ear = Ear(self.watch, device, controls_from)

    def say(self, device: str, reading: Reading | None, state: readings.State = "live") -> None:
        """Write a sample, or a status alone, and see that it was heard."""
        self.counts[device] += reading is not None
        parts = readings.parts(reading) if reading is not None else ()
        status = Status(state=state, reason="so", new=self.counts[device], parts=parts)
        values = readings.encode(device, reading) if reading is not None else {}
        key, before = readings.watched_keys(device)[0], self.watch.latest(readings.watched_keys(device)[0])
        self.bus.publish(values | readings.encode_status(device, status))
        wait_until(lambda: self.watch.latest(key) is not before)

    def hear_of(self, said: Mapping[str, tuple[Reading, readings.State]]) -> Heard:
        """Say something and hear it; again where the machine took longer over it than a device server may."""
        found: list[Heard] = []

        def heard() -> bool:
            for device, (reading, state) in said.items():
                self.say(device, reading, state)
            found.append(self.ear.hear())
            return found[-1].reading is not None

        wait_until(heard)
        return found[-1]


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="tests", timeout_s=5.0) as line:
        yield line


@pytest.fixture
def one(bus: Bus) -> Iterator[Devices]:
    made = Devices(bus, "pico")
    yield made
    made.watch.close()


@pytest.fixture
def two(bus: Bus) -> Iterator[Devices]:
    made = Devices(bus, "gello", "gamepad")
    yield made
    made.watch.close()


PRESSED = Reading(controls={"left_bumper": 1.0})
JOINTS = Reading(joints=np.arange(3.0))


def test_device_that_never_spoke_is_asked_for(one: Devices) -> None:
    assert one.ear.hear().flaw == "nothing was ever heard of pico; is its server started?"


def test_live_sample_is_heard_until_its_server_falls_silent(one: Devices) -> None:
    heard = one.hear_of({"pico": (PRESSED, "live")})
    assert heard.flaw == ""
    assert heard.reading is not None
    assert heard.reading.controls == {"left_bumper": 1.0}
    assert heard.sample >= 1
    until_s = time.monotonic() + STALE_S
    wait_until(lambda: time.monotonic() > until_s)
    assert one.ear.hear().reading is None
    assert "pico is silent" in one.ear.hear().flaw


def test_device_that_is_not_live_by_its_own_word_gives_nothing(one: Devices) -> None:
    one.say("pico", PRESSED, "stale")
    assert one.ear.hear().reading is None
    assert one.ear.hear().flaw.startswith("pico is s")


@pytest.mark.parametrize(("late_s", "boot", "is_of_use"), [(2.0, "", False), (0.1, "", True), (2.0, "0badb007", True)])
def test_samples_that_a_frozen_line_kept_drive_nobody_but_their_buttons_count(
    one: Devices, late_s: float, boot: str, is_of_use: bool
) -> None:
    """The device of another machine has a clock that says nothing here."""
    whole = Reading(joints=np.arange(3.0), controls={"left_bumper": 1.0})
    status = Status(state="live", new=1, parts=readings.parts(whole))
    values = readings.encode("pico", whole) | readings.encode_status("pico", status)
    source = f"pico.1.{boot or stamp.boot_id()}.beef"

    found: list[Heard] = []

    def heard() -> bool:
        written_ns = time.monotonic_ns() - round(late_s * 1e9)
        mark = stamp.Stamp(1, written_ns, 0, source).encode()
        before = one.watch.latest(readings.watched_keys("pico")[0])
        one.bus.call("MSET", *(word for key, value in values.items() for word in (key, value, keys.stamp(key), mark)))
        wait_until(lambda: one.watch.latest(readings.watched_keys("pico")[0]) is not before)
        found.append(one.ear.hear())
        return found[-1].reading is not None and (not found[-1].flaw) == is_of_use

    wait_until(heard)
    reading = found[-1].reading
    assert reading is not None
    assert reading.controls == {"left_bumper": 1.0}
    assert (reading.joints is not None) == is_of_use
    assert is_of_use or found[-1].flaw.startswith("samples of pico come 2.")


def test_value_that_is_none_is_a_flaw_and_no_crash(one: Devices) -> None:
    one.bus.publish({readings.watched_keys("pico")[0]: b"{}"})
    wait_until(lambda: one.watch.latest(readings.watched_keys("pico")[0]))
    assert one.ear.hear().reading is None
    assert one.ear.hear().flaw


def test_buttons_of_another_device_count_also_while_poses_are_lost(two: Devices) -> None:
    heard = two.hear_of({"gello": (JOINTS, "lost"), "gamepad": (PRESSED, "live")})
    assert heard.reading is not None
    assert heard.reading.controls == {"left_bumper": 1.0}
    assert heard.reading.joints is None
    assert heard.flaw.startswith("gello is ")


def test_poses_without_the_device_that_has_the_buttons_are_of_no_use(two: Devices) -> None:
    two.say("gello", JOINTS)
    assert two.ear.hear().reading is None
    assert "gamepad" in two.ear.hear().flaw
