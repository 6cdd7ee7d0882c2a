"""The gamepad adapter on the real pygame, with virtual pads of its SDL."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.fakes.gamepad import install
from adapters.devices.fakes.gamepad.pad import FakePad, PadStep
from adapters.devices.fakes.script import Script
from adapters.devices.gamepad import names, sdl
from adapters.devices.gamepad.device import Gamepad
from adapters.devices.gamepad.kind import GamepadConfig
from station.errors import BadFile
from station.operator.device import Device, DeviceError
from tests.adapters.devices.by_hand import HandClock
from tests.waiting import wait_until

Plug = Callable[..., FakePad]
Open = Callable[..., Gamepad]


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def plugged() -> list[FakePad]:
    return []


@pytest.fixture
def plug(clock: HandClock, plugged: list[FakePad]) -> Iterator[Plug]:
    """Plugs virtual pads in."""
    sdl.start()

    def begin(*steps: PadStep, **options: Any) -> FakePad:
        plugged.append(FakePad(Script(steps or (PadStep(at_s=0.0),)), clock, **options))
        return plugged[-1]

    yield begin
    for pad in plugged:
        pad.close()


@pytest.fixture
def opened(plugged: list[FakePad]) -> Iterator[Open]:
    """Opens a pad, and lets the scripts of all begin."""
    devices: list[Gamepad] = []

    def begin(**options: Any) -> Gamepad:
        devices.append(Gamepad(**options))
        for pad in plugged:
            pad.begin()
        return devices[-1]

    yield begin
    for device in devices:
        device.close()


def shown(device: Gamepad) -> dict[str, float]:
    """Return what is not at rest."""
    reading = device.read()
    assert reading is not None
    return {name: round(value, 3) for name, value in reading.controls.items() if value}


def test_a_pad_at_rest_gives_a_sample_of_rest_at_every_call(plug: Plug, opened: Open) -> None:
    plug()
    device = opened()
    assert isinstance(device, Device)
    for _ in range(3):
        reading = device.read()
        assert reading is not None, "silence is rest, not loss"
        assert dict(reading.controls) == dict.fromkeys(names.CONTROLS, 0.0)


@pytest.mark.parametrize("control", names.CONTROLS)
def test_every_control_shows_under_its_own_name(plug: Plug, opened: Open, control: str) -> None:
    plug(PadStep(at_s=0.0, set={control: 1.0}))
    assert shown(opened()) == {control: 1.0}


def test_a_stick_is_positive_to_the_right_and_forward(plug: Plug, opened: Open, clock: HandClock) -> None:
    plug(PadStep(at_s=0.0, set={"left_stick_x": -1.0, "right_stick_y": -1.0}))
    device = opened()
    assert shown(device) == {"left_stick_x": -1.0, "right_stick_y": -1.0}
    # SDL's own number for "towards the person" is positive: nothing of the fake's making.
    assert device._opened.get_axis(3) == 32767


def test_a_trigger_is_at_rest_until_its_first_event(plug: Plug, opened: Open, clock: HandClock) -> None:
    plug(PadStep(at_s=0.5, set={"left_trigger": 1.0}), PadStep(at_s=1.0, set={"left_trigger": 0.0}))
    device = opened()
    assert shown(device) == {}
    clock.pass_(0.5)
    assert shown(device) == {"left_trigger": 1.0}
    clock.pass_(0.5)
    assert shown(device) == {}


def test_a_dead_band_is_round_and_has_no_step_at_its_edge(plug: Plug, opened: Open, clock: HandClock) -> None:
    places = [(0.07, 0.07), (0.1, 0.1), (0.6, 0.8), (0.25, 0.0)]
    plug(
        *(PadStep(at_s=0.1 * index, set={"left_stick_x": x, "left_stick_y": y}) for index, (x, y) in enumerate(places))
    )
    device = opened(dead_band=0.1)
    assert shown(device) == {}
    clock.pass_(0.1)
    edge = math.hypot(0.1, 0.1)
    assert shown(device)["left_stick_x"] == pytest.approx(0.1 * (edge - 0.1) / 0.9 / edge, abs=1e-3)
    clock.pass_(0.1)
    assert shown(device) == {"left_stick_x": pytest.approx(0.6, abs=2e-3), "left_stick_y": pytest.approx(0.8, abs=2e-3)}
    clock.pass_(0.1)
    assert shown(device) == {"left_stick_x": pytest.approx(0.15 / 0.9, abs=2e-3)}


def test_the_corners_of_a_square_stick_are_not_faster(plug: Plug, opened: Open) -> None:
    plug(PadStep(at_s=0.0, set={"left_stick_x": 1.0, "left_stick_y": 1.0}))
    assert math.hypot(*shown(opened()).values()) == pytest.approx(1.0, abs=2e-3)


def test_two_hundred_events_are_taken_in_by_one_call(plug: Plug, opened: Open, clock: HandClock) -> None:
    plug()
    device = opened()
    device.read()
    for index in range(200):  # as SDL would have queued them while nobody looked
        device._pygame.event.post(
            device._pygame.event.Event(
                device._pygame.CONTROLLERAXISMOTION, instance_id=device._id, axis=0, value=-index * 100
            )
        )
    assert shown(device)["left_stick_x"] == pytest.approx((19900 / 32767 - 0.05) / 0.95 * -1, abs=1e-3)
    assert not device._pygame.event.peek(device._pygame.CONTROLLERAXISMOTION)


def test_a_tap_that_is_over_by_now_is_seen_once(plug: Plug, opened: Open) -> None:
    plug()
    device = opened()
    device.read()
    pygame = device._pygame
    for kind in (pygame.CONTROLLERBUTTONDOWN, pygame.CONTROLLERBUTTONUP):
        pygame.event.post(pygame.event.Event(kind, instance_id=device._id, button=0))
    assert shown(device) == {"right_primary": 1.0}
    assert shown(device) == {}


def test_a_pad_that_is_torn_out_gives_rest_is_gone_and_comes_back(plug: Plug, opened: Open, clock: HandClock) -> None:
    held = {"left_stick_y": 1.0, "right_primary": 1.0}
    pad = plug(
        PadStep(at_s=0.0, set=held),
        PadStep(at_s=1.0, plugged=False),
        PadStep(at_s=2.0, plugged=True),
        PadStep(at_s=3.0, set={"right_primary": 0.0, "left_stick_y": 0.525}),
    )
    device = opened()
    assert shown(device) == held
    clock.pass_(1.0)
    wait_until(lambda: pad._id is None)
    assert shown(device) == {}, "never the last deflection"
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"gamepad 'Fake gamepad': gone; plug it in again"):
            device.read()
    with pytest.raises(DeviceError, match="no gamepad found"):
        Gamepad()
    clock.pass_(1.0)
    wait_until(lambda: pad._id is not None)
    again = opened()
    assert shown(again) == {}, "what was held meanwhile is nobody's command"
    clock.pass_(1.0)
    assert shown(again) == {"left_stick_y": 0.5}


def test_pads_that_come_and_go_before_anybody_looks_cost_at_most_an_opening(plug: Plug, opened: Open) -> None:
    pad = plug()
    device = opened()
    held = {"right_primary": 1.0}
    for _ in range(3):  # a loose plug: pygame stumbles over what SDL says of pads that are gone by now
        pad.unplug()
        pad.plug()
    shown(device)
    with pytest.raises(DeviceError, match=r"^gamepad 'Fake gamepad': (gone|SDL lost count)"):
        device.read()
    again = opened()
    pad._state.update(held)
    assert shown(again) == held


def test_a_script_begun_midway_shows_the_pad_as_it_stands_then(plug: Plug, clock: HandClock) -> None:
    steps = [PadStep(at_s=float(at_s), plugged=at_s % 2 == 0) for at_s in range(1, 9)]
    pad = plug(*steps, PadStep(at_s=9.0, set={"right_primary": 1.0}))
    device = Gamepad()
    first = pad._id
    pad.begin(9.5)
    wait_until(lambda: pad._plugging._next is None)
    assert shown(device) == {"right_primary": 1.0}
    assert pad._id == first, "it was torn out and back four times before"


def test_events_of_another_pad_are_not_ours(plug: Plug, opened: Open) -> None:
    plug()
    device = opened()
    pygame = device._pygame
    for kind in (pygame.CONTROLLERBUTTONDOWN, pygame.CONTROLLERDEVICEREMOVED):
        pygame.event.post(pygame.event.Event(kind, instance_id=device._id + 1, button=0))
    assert shown(device) == {}
    assert shown(device) == {}, "and it is still there"


def test_a_pad_that_is_gone_is_at_rest_though_nothing_said_so(plug: Plug, opened: Open) -> None:
    plug(PadStep(at_s=0.0, set={"left_stick_y": 1.0, "right_primary": 1.0}))
    device = opened()
    assert shown(device)["left_stick_y"] == 1.0
    pygame = device._pygame
    pygame.event.post(pygame.event.Event(pygame.CONTROLLERDEVICEREMOVED, instance_id=device._id))
    assert shown(device) == {}, "whether or not SDL centres it first"


def test_two_pads_are_named_and_one_can_be_chosen(plug: Plug, opened: Open) -> None:
    plug(name="Blue pad")
    plug(name="Red pad")
    with pytest.raises(DeviceError) as caught:
        Gamepad()
    message = str(caught.value)
    assert message.startswith("2 gamepads found: 0 'Blue pad' (guid ")
    assert message.endswith("; choose one with name: or index:")
    assert [pad.split(" (")[0] for pad in sdl.plugged_in()] == ["0 'Blue pad'", "1 'Red pad'"]
    assert opened(name="red").facts()["model"] == "Red pad"
    with pytest.raises(DeviceError, match=r"no gamepad with name 'green' and index 0; found: 0 'Blue pad'"):
        Gamepad(name="green", index=0)


def test_a_pad_that_sdl_does_not_know_has_numbered_controls(plug: Plug, opened: Open, clock: HandClock) -> None:
    plug(PadStep(at_s=0.1, set={"left_stick_x": 1.0, "right_secondary": 1.0}), is_known=False)
    device = opened()
    facts = device.facts()
    assert not facts["is_mapped"]
    assert facts["controls"][:6] == [f"axis_{number}" for number in range(6)]
    assert shown(device) == {}
    clock.pass_(0.1)
    assert shown(device) == {"axis_0": 1.0, "button_1": 1.0}


PEDALS = {
    "left_stick_y": "axis_1@-1 - axis_0@-1", "right_stick_x": "-axis_2", "right_trigger": "axis_4@1",
    "left_bumper": "button_0 + button_3",
}  # fmt: skip
REST = {"left_stick_x": -1.0, "left_stick_y": 1.0, "left_trigger": 1.0}
"""Of the fake pad's axes 0, 1 and 4: SDL's y is the other way about."""


@pytest.mark.parametrize("is_known", [False, True])
def test_pedals_walk_as_sticks_do_and_one_that_was_never_touched_is_at_rest(
    plug: Plug, opened: Open, clock: HandClock, is_known: bool
) -> None:
    plug(
        PadStep(at_s=0.1, set=REST | {"left_stick_y": -1.0}),
        PadStep(at_s=0.2, set=REST | {"left_stick_x": 0.0}),
        PadStep(at_s=0.3, set=REST | {"right_stick_x": 1.0, "right_primary": 1.0}),
        PadStep(at_s=0.4, set=REST | {"right_stick_x": 0.0, "right_primary": 0.0, "left_trigger": 0.5}),
        is_known=is_known,
    )
    device = opened(controls=PEDALS, dead_band=0.0)
    assert shown(device) == {}, "before SDL has said anything of its axes"
    for expected in (
        {"left_stick_y": 1.0},
        {"left_stick_y": -0.5},
        {"right_stick_x": -1.0, "left_bumper": 1.0},
        {"right_trigger": 0.5},
    ):
        clock.pass_(0.1)
        found = shown(device)
        assert {name: round(value, 2) for name, value in found.items()} == expected
    assert device.facts()["controls"] == list(names.CONTROLS)


def test_pedals_that_are_torn_out_are_at_rest(plug: Plug, opened: Open) -> None:
    pad = plug(PadStep(at_s=0.0, set=REST | {"left_stick_y": -1.0}), is_known=False)
    device = opened(controls=PEDALS, dead_band=0.0)
    assert shown(device) == {"left_stick_y": 1.0}
    pad.unplug()
    wait_until(lambda: shown(device) == {})
    with pytest.raises(DeviceError, match="gone; plug it in again"):
        device.read()


def test_a_pedal_that_is_not_there_is_named(plug: Plug) -> None:
    plug(is_known=False)
    with pytest.raises(DeviceError, match=r"controls: no axis_9, hat_0_x; it has 6 axes, 15 buttons and 0 hats"):
        Gamepad(controls={"left_stick_y": "axis_9", "dpad_up": "hat_0_x"})


@pytest.mark.parametrize(
    ("controls", "said"),
    [
        ({"left_stik_y": "axis_1"}, "no control 'left_stik_y' (did you mean 'left_stick_y'?)"),
        ({"left_stick_y": "axis1"}, "left_stick_y is 'axis1'; expected terms such as axis_1"),
        ({"left_stick_y": "axis_1 axis_2"}, "expected terms such as axis_1"),
        ({"left_stick_y": "axis_1 -"}, "expected terms such as axis_1"),
        ({"left_stick_y": ""}, "expected terms such as axis_1"),
        ({"left_stick_y": "axis_1@-1", "left_stick_x": "axis_1"}, "left_stick_x: axis_1 rests elsewhere"),
    ],
)
def test_controls_that_cannot_be_are_refused_in_a_line(controls: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=r"^controls: ") as caught:
        GamepadConfig(controls=controls)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_controls_and_a_mapping_do_not_go_together() -> None:
    with pytest.raises(ValueError, match="controls and mapping both say"):
        GamepadConfig(controls={"left_stick_y": "axis_1"}, mapping="0300,Pad,a:b0,b:b1")


def test_no_pad_is_one_line() -> None:
    with pytest.raises(DeviceError, match=r"^no gamepad found; plug one in, or wake a wireless one$"):
        Gamepad()


def test_a_pad_that_may_not_be_read_brings_the_udev_rule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "class" / "js0" / "device" / "event7").mkdir(parents=True)
    nodes = tmp_path / "input"
    nodes.mkdir()
    (nodes / "event7").touch(mode=0)
    monkeypatch.setattr("adapters.devices.gamepad.sdl.os.access", lambda path, mode: False)  # root may read anything
    message = sdl.why_none(tmp_path / "class", nodes)
    assert f"gamepad at {nodes / 'event7'}: permission denied; install this udev rule" in message
    assert 'ENV{ID_INPUT_JOYSTICK}=="1"' in message
    assert "\n" not in message


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DeviceError, match=r"pip install 'teleop-station\[gamepad\]'"):
        Gamepad()


def test_the_same_script_gives_the_same_samples_every_time(tmp_path: Path) -> None:
    file = tmp_path / "walk.json"
    steps = [{"at_s": 0.2, "set": {"left_stick_y": 0.5}}, {"at_s": 0.5, "set": {"dpad_up": 1}},
             {"at_s": 0.6, "set": {"dpad_up": 0}}, {"at_s": 0.8, "set": {"left_stick_y": 0}}]  # fmt: skip
    file.write_text(json.dumps({"device": "gamepad", "period_s": 1.0, "steps": steps}))

    def played() -> list[dict[str, float]]:
        clock = HandClock()
        pad = install(file, clock)
        device = Gamepad()
        pad.begin()
        try:
            samples = []
            for _ in range(250):
                samples.append(shown(device))
                clock.pass_(0.01)
            return samples
        finally:
            device.close()
            pad.close()

    first = played()
    assert first == played()
    assert sum("dpad_up" in sample for sample in first) == 2 * 10
    assert {sample.get("left_stick_y", 0.0) for sample in first} == {0.0, 0.474}


@pytest.mark.parametrize(
    ("step", "told"),
    [
        ({"at_s": 0, "set": {"left_stik_x": 1}}, "no control 'left_stik_x' (did you mean 'left_stick_x'?)"),
        ({"at_s": 0, "set": {"start": 2}}, "start is 2; expected -1 to 1"),
    ],
)
def test_a_bad_script_is_one_line(tmp_path: Path, step: dict[str, Any], told: str) -> None:
    file = tmp_path / "bad.json"
    file.write_text(json.dumps({"device": "gamepad", "steps": [step]}))
    with pytest.raises(BadFile) as caught:
        install(file)
    assert told in str(caught.value)
