"""What is heard of an operator's device, in virtual time: the test plays the device servers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from station.bus import keys, stamp
from station.bus.client import Bus
from station.operator import sample as readings
from station.operator.device_subscriber import DeviceSample, DeviceSubscriber
from station.operator.sample import OperatorSample, Status
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network

SILENT_S = 0.1
"""So long a device's server may be silent before nobody drives by what it said last, as the docs promise [s]."""

HEARD_S = 0.01
"""What is written is heard after so long [s]."""


class Devices:
    """Device servers that say what they are told to, and who listens to them."""

    def __init__(self, bus: Bus, device: str, controls_from: str = "") -> None:
        self.bus, self.counts = bus, dict.fromkeys((device, controls_from), 0)
        self.watch = bus.watch(DeviceSubscriber.watched(device, controls_from))
        self.subscriber = DeviceSubscriber(self.watch, device, controls_from)

    def say(self, device: str, sample: OperatorSample | None, state: readings.State = "live") -> None:
        """Write a sample, or a status alone, and see that it was heard."""
        self.counts[device] += sample is not None
        parts = readings.parts(sample) if sample is not None else ()
        status = Status(state=state, reason="so", new=self.counts[device], parts=parts)
        values = readings.encode(device, sample) if sample is not None else {}
        self.bus.publish(values | readings.encode_status(device, status))
        self.bus.clock.sleep(HEARD_S)

    def hear_of(self, said: Mapping[str, tuple[OperatorSample, readings.State]]) -> DeviceSample:
        """Say something and hear it."""
        for device, (sample, state) in said.items():
            self.say(device, sample, state)
        return self.subscriber.poll()


@pytest.fixture
def network() -> Iterator[Network]:
    with VirtualClock(1) as clock:
        yield Network(clock, (20_000, 200_000))


@pytest.fixture
def bus(network: Network) -> Iterator[Bus]:
    with Bus(network.address(), name="tests", timeout_s=1.0) as line:
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


PRESSED = OperatorSample(controls={"left_bumper": 1.0})
JOINTS = OperatorSample(joints=np.arange(3.0))


def test_device_that_never_spoke_is_asked_for(one: Devices) -> None:
    assert one.subscriber.poll().why_not == "nothing was ever heard of pico; is its server started?"


def test_live_sample_is_heard_until_its_server_falls_silent(one: Devices) -> None:
    heard = one.hear_of({"pico": (PRESSED, "live")})
    assert heard.why_not == ""
    assert heard.sample is not None
    assert heard.sample.controls == {"left_bumper": 1.0}
    assert heard.number >= 1
    one.bus.clock.sleep(SILENT_S - 2 * HEARD_S)
    assert one.subscriber.poll().sample is not None
    one.bus.clock.sleep(2 * HEARD_S)
    assert one.subscriber.poll().sample is None
    assert "pico is silent" in one.subscriber.poll().why_not


def test_device_that_is_not_live_by_its_own_word_gives_nothing(one: Devices) -> None:
    one.say("pico", PRESSED, "stale")
    assert one.subscriber.poll().sample is None
    assert one.subscriber.poll().why_not.startswith("pico is s")


@pytest.mark.parametrize(("late_s", "boot", "is_of_use"), [(2.0, "", False), (0.1, "", True), (2.0, "0badb007", True)])
def test_samples_that_a_frozen_line_kept_drive_nobody_but_their_buttons_count(
    one: Devices, late_s: float, boot: str, is_of_use: bool
) -> None:
    """The device of another machine has a clock that says nothing here."""
    whole = OperatorSample(joints=np.arange(3.0), controls={"left_bumper": 1.0})
    status = Status(state="live", new=1, parts=readings.parts(whole))
    values = readings.encode("pico", whole) | readings.encode_status("pico", status)
    source = f"pico.1.{boot or stamp.boot_id()}.beef"

    written_ns = one.bus.clock.monotonic_ns() - round(late_s * 1e9)
    mark = stamp.Stamp(1, written_ns, 0, source).encode()
    one.bus.call("MSET", *(word for key, value in values.items() for word in (key, value, keys.stamp(key), mark)))
    one.bus.clock.sleep(HEARD_S)
    heard = one.subscriber.poll()
    sample = heard.sample
    assert sample is not None
    assert sample.controls == {"left_bumper": 1.0}
    assert (sample.joints is not None) == is_of_use
    assert (not heard.why_not) == is_of_use
    assert is_of_use or heard.why_not.startswith("samples of pico come 2.")


def test_value_that_is_none_is_a_flaw_and_no_crash(one: Devices) -> None:
    one.bus.publish({readings.watched_keys("pico")[0]: b"{}"})
    one.bus.clock.sleep(HEARD_S)
    assert one.subscriber.poll().sample is None
    assert one.subscriber.poll().why_not


def test_buttons_of_another_device_count_also_while_poses_are_lost(two: Devices) -> None:
    heard = two.hear_of({"gello": (JOINTS, "lost"), "gamepad": (PRESSED, "live")})
    assert heard.sample is not None
    assert heard.sample.controls == {"left_bumper": 1.0}
    assert heard.sample.joints is None
    assert heard.why_not.startswith("gello is ")


def test_poses_without_the_device_that_has_the_buttons_are_of_no_use(two: Devices) -> None:
    two.say("gello", JOINTS)
    assert two.subscriber.poll().sample is None
    assert "gamepad" in two.subscriber.poll().why_not
