"""The spacemouse adapter on the real hidapi library, whose C functions play scripted devices."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from adapters.devices.fakes.script import Script
from adapters.devices.fakes.spacemouse.hidapi import FakeHidapi
from adapters.devices.fakes.spacemouse.mouse import REPEAT_S, FakeMouse, MouseStep
from adapters.devices.spacemouse.device import Spacemouse
from adapters.devices.spacemouse.find import library, plugged_in
from station.operator.device import Device, DeviceError
from tests.adapters.devices.by_hand import HandClock

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the fake replaces C functions of a Linux library")

FORWARD = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
REST = (0.0,) * 6
WIRELESS, RECEIVER, PRO = (0x256F, 0xC62E), (0x256F, 0xC652), (0x046D, 0xC62B)

Plug = Callable[..., None]


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def plug() -> Iterator[Plug]:
    """Plugs fake mice in, in place of what this machine may have."""
    fakes: list[FakeHidapi] = []

    def begin(*mice: FakeMouse) -> None:
        fakes.append(FakeHidapi(mice))
        fakes[-1].install(library())

    yield begin
    for fake in fakes:
        fake.remove()


@pytest.fixture
def opened() -> Iterator[list[Spacemouse]]:
    """Devices to close before the C functions go."""
    devices: list[Spacemouse] = []
    yield devices
    for device in devices:
        device.close()


def scripted(clock: HandClock, *steps: MouseStep, **options: Any) -> FakeMouse:
    return FakeMouse(Script(steps or (MouseStep(at_s=0.0),)), clock, **options)


def twist(device: Spacemouse) -> list[float]:
    reading = device.read()
    assert reading is not None
    assert reading.twist is not None
    return [round(float(value), 9) for value in reading.twist]


def test_a_spacemouse_at_rest_gives_a_sample_of_rest_at_every_call(
    plug: Plug, opened: list[Spacemouse], clock: HandClock
) -> None:
    plug(scripted(clock))
    opened.append(device := Spacemouse())
    assert isinstance(device, Device)
    for _ in range(3):
        reading = device.read()
        assert reading is not None, "silence is rest, not loss"
        assert reading.twist is not None
        assert not reading.twist.any()
        assert reading.controls == {"button_0": 0.0, "button_1": 0.0}


@pytest.mark.parametrize("model", [(0x256F, 0xC635), WIRELESS])
def test_a_held_cap_is_a_twist_in_flu_and_buttons_are_controls(
    plug: Plug, opened: list[Spacemouse], clock: HandClock, model: tuple[int, int]
) -> None:
    plug(scripted(clock, MouseStep(at_s=0.0, twist=(0.5, 0.0, 0.0, 0.0, -1.0, 1.0)), MouseStep(at_s=0.1, buttons=[1]),
                  model=model))  # fmt: skip
    opened.append(device := Spacemouse(dead_band=0.0, scale=(1.0, 1.0, 1.0, 1.0, 1.0, -0.5)))
    assert twist(device) == [0.5, 0.0, 0.0, 0.0, -1.0, -0.5]
    clock.pass_(0.1)
    reading = device.read()
    assert reading is not None
    assert reading.controls == {"button_0": 0.0, "button_1": 1.0}


def test_two_hundred_queued_reports_are_taken_in_by_one_call(
    plug: Plug, opened: list[Spacemouse], clock: HandClock
) -> None:
    plug(scripted(clock, MouseStep(at_s=0.0, twist=FORWARD), MouseStep(at_s=100 * REPEAT_S, twist=REST)))
    opened.append(device := Spacemouse())
    assert twist(device) == list(FORWARD)
    clock.pass_(100 * REPEAT_S)
    assert twist(device) == list(REST), "an old report is never given"
    assert device._reports == 2 * 101, "and every one was read: 99 that hold the cap, two halves each"


def test_a_deflection_that_nothing_confirms_counts_as_let_go(
    plug: Plug, opened: list[Spacemouse], clock: HandClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    # One report of motion and then silence: what is left when a wireless mouse moves out of reach.
    plug(scripted(clock, MouseStep(at_s=0.0, report="01 00 00 a2 fe 00 00")))
    opened.append(device := Spacemouse(silence_s=0.5, clock=clock))
    assert twist(device) == list(FORWARD)
    clock.pass_(0.49)
    assert twist(device) == list(FORWARD)
    clock.pass_(0.02)
    assert twist(device) == list(REST)


def test_a_mouse_that_is_torn_out_gives_rest_and_is_then_gone(
    plug: Plug, opened: list[Spacemouse], clock: HandClock
) -> None:
    plug(scripted(clock, MouseStep(at_s=0.0, twist=FORWARD, buttons=[0]), MouseStep(at_s=1.0, plugged=False)))
    opened.append(device := Spacemouse())
    assert twist(device) == list(FORWARD)
    clock.pass_(1.0)
    reading = device.read()
    assert reading is not None
    assert reading.twist is not None
    assert not reading.twist.any(), "never the last deflection"
    assert not any(reading.controls.values())
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"SpaceMouse Compact \(serial FAKE-1.*gone.*plug it in again"):
            device.read()
    with pytest.raises(DeviceError, match="no spacemouse found"):
        Spacemouse()


def test_a_mouse_that_is_plugged_in_again_is_opened_anew_and_starts_at_rest(
    plug: Plug, opened: list[Spacemouse], clock: HandClock
) -> None:
    plug(scripted(clock, MouseStep(at_s=0.0, twist=FORWARD), MouseStep(at_s=1.0, plugged=False),
                  MouseStep(at_s=2.0, plugged=True), MouseStep(at_s=3.0, twist=FORWARD)))  # fmt: skip
    opened.append(device := Spacemouse())
    twist(device)
    clock.pass_(2.5)  # both happened between two looks
    assert twist(device) == list(REST)
    with pytest.raises(DeviceError):
        device.read()
    opened.append(again := Spacemouse())
    assert twist(again) == list(REST)
    clock.pass_(0.5)
    assert twist(again) == list(FORWARD)


def test_a_receiver_is_heard_on_whichever_interface_its_mouse_speaks(
    plug: Plug, opened: list[Spacemouse], clock: HandClock
) -> None:
    silent = scripted(clock, model=RECEIVER, path="/dev/hidraw-a", number=0, serial="")
    speaking = scripted(clock, MouseStep(at_s=0.0, twist=FORWARD), model=RECEIVER, path="/dev/hidraw-b", number=1,
                        serial="")  # fmt: skip
    speaking.usage = (65290, 1)
    plug(silent, speaking)
    opened.append(device := Spacemouse())
    assert twist(device) == list(FORWARD)
    assert device.facts()["paths"] == ["/dev/hidraw-a", "/dev/hidraw-b"]


def test_two_mice_are_named_and_one_can_be_chosen(plug: Plug, opened: list[Spacemouse], clock: HandClock) -> None:
    plug(scripted(clock, path="/dev/hidraw-a"), scripted(clock, path="/dev/hidraw-b", serial="B-7", model=PRO))
    with pytest.raises(DeviceError) as caught:
        Spacemouse()
    assert str(caught.value) == (
        "2 spacemice found: SpaceMouse Compact (serial FAKE-1, /dev/hidraw-a); "
        "SpaceMouse Pro (serial B-7, /dev/hidraw-b); choose one with serial: or path:"
    )
    assert plugged_in() == ["SpaceMouse Compact (serial FAKE-1, /dev/hidraw-a)",
                            "SpaceMouse Pro (serial B-7, /dev/hidraw-b)"]  # fmt: skip
    opened.append(device := Spacemouse(serial="B-7"))
    assert device.facts()["model"] == "SpaceMouse Pro"
    assert device.facts()["buttons"]["button_12"] == "1"
    opened.append(other := Spacemouse(path="/dev/hidraw-a"))
    assert other.facts()["serial"] == "FAKE-1"
    with pytest.raises(DeviceError, match=r"no spacemouse with serial 'C'; found: SpaceMouse Compact"):
        Spacemouse(serial="C")


def test_two_receivers_are_two_devices(plug: Plug, clock: HandClock) -> None:
    plug(*(scripted(clock, model=RECEIVER, path=f"/dev/hidraw-{name}", number=number, serial="")
           for name, number in (("a", 0), ("b", 1), ("c", 0), ("d", 1))))  # fmt: skip
    with pytest.raises(DeviceError, match="2 spacemice found"):
        Spacemouse()
    with pytest.raises(DeviceError, match="2 spacemice found"):
        Spacemouse()


def test_no_mouse_is_one_line(plug: Plug) -> None:
    plug()
    with pytest.raises(DeviceError, match=r"^no spacemouse found; plug one in"):
        Spacemouse()


def test_a_mouse_of_the_same_maker_is_no_spacemouse(plug: Plug, clock: HandClock) -> None:
    cad_mouse = scripted(clock)
    cad_mouse.product_id, cad_mouse.usage = 0xC650, (1, 2)
    plug(cad_mouse)
    with pytest.raises(DeviceError, match="no spacemouse found"):
        Spacemouse()


def test_a_model_that_came_after_us_is_read_all_the_same(
    plug: Plug, opened: list[Spacemouse], clock: HandClock
) -> None:
    new = scripted(clock, MouseStep(at_s=0.0, twist=FORWARD, buttons=[3]))
    new.product_id = 0xC6FF
    plug(new)
    opened.append(device := Spacemouse())
    reading = device.read()
    assert reading is not None
    assert reading.twist is not None
    assert reading.twist.tolist() == list(FORWARD)
    assert reading.controls["button_3"] == 1.0
    assert device.facts()["model"] == "unknown model 256f:c6ff"


def test_a_missing_permission_brings_the_udev_rule(plug: Plug, clock: HandClock) -> None:
    plug(scripted(clock, denied=True))
    with pytest.raises(DeviceError) as caught:
        Spacemouse()
    message = str(caught.value)
    assert "permission denied; install this udev rule" in message
    assert 'KERNEL=="hidraw*"' in message
    assert "| sudo tee /etc/udev/rules.d/70-spacemouse.rules" in message
    assert "\n" not in message


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "hidraw", None)
    monkeypatch.setitem(sys.modules, "hid", None)
    with pytest.raises(DeviceError, match=r"pip install 'teleop-station\[spacemouse\]'"):
        Spacemouse()


def test_another_package_of_the_same_name_is_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "hidraw", None)
    monkeypatch.setitem(sys.modules, "hid", importlib.import_module("json"))
    with pytest.raises(DeviceError, match="not that of the package hidapi"):
        Spacemouse()
