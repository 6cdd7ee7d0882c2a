"""The gamepad server as a process of its own: the real pygame, a virtual pad of its SDL, and a real bus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.devices.gamepad.kind import GamepadConfig
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.servers.device_station import Station, station


@pytest.fixture
def pad(bus_server: BusAddress, tmp_path: Path) -> Iterator[Station]:
    with station("gamepad", bus_server, tmp_path) as made:
        yield made


def test_a_script_stands_on_the_bus_and_a_torn_out_pad_is_rest_then_lost_then_back(pad: Station) -> None:
    walk = {"left_stick_y": 1.0, "left_bumper": 1.0}
    pad.start([{"at_s": 0.5, "set": walk}, {"at_s": 2.5, "plugged": False}, {"at_s": 4.5, "plugged": True},
               {"at_s": 8.0, "set": {"left_stick_y": 0.5}}])  # fmt: skip
    pad.until_back("gamepad 'Fake gamepad': gone", beside=lambda: pad.samples[-1].controls["left_stick_y"])
    controls = [sample.controls for sample in pad.samples]
    held = [index for index, each in enumerate(controls) if each["left_bumper"]]
    assert controls[held[0]]["left_stick_y"] == 1.0
    assert not any(controls[held[-1] + 1].values()), "the last sample before it was gone is of rest"
    assert pad.facts["device"]["is_mapped"]
    assert pad.stop() == 0


def test_without_a_pad_it_ends_with_one_line(pad: Station) -> None:
    pad.start(before="import os; os.environ['SDL_JOYSTICK_DISABLE_UDEV'] = '1'\n", pad="no such pad")
    code, words = pad.ends()
    assert code == 1
    assert words.startswith(("no gamepad found", "no gamepad with name", "gamepad at /dev/input/"))


def test_without_the_library_it_names_the_extra(pad: Station) -> None:
    pad.start(before="import sys; sys.modules['pygame'] = None\n")
    code, words = pad.ends()
    assert code == 1
    assert "pip install 'teleop-station[gamepad]'" in words


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"rate_hz": 5}, "rate_hz is 5; expected 10 to 500 Hz"),
        ({"dead_band": 0.9}, "dead_band is 0.9; expected 0 to 0.5"),
        ({"mapping": "a:b0"}, "mapping is no SDL mapping"),
    ],
)
def test_bad_settings_are_one_line(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(GamepadConfig, values, where="server gamepad")
    assert told in str(caught.value)
