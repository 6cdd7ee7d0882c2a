"""The spacemouse server as a process of its own: the real hidapi, a script under it, and a real bus."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.devices.spacemouse.kind import SpacemouseConfig
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.servers.device_station import Station, station

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the fake replaces C functions of a Linux library")


@pytest.fixture
def mouse(bus_server: BusAddress, tmp_path: Path) -> Iterator[Station]:
    with station("spacemouse", bus_server, tmp_path) as made:
        yield made


def is_pushed(mouse: Station) -> bool:
    twist = mouse.samples[-1].twist
    return twist is not None and bool(twist[1] > 0.4)


def test_a_script_stands_on_the_bus_and_a_torn_out_mouse_is_zero_then_lost_then_back(mouse: Station) -> None:
    push, rest = [0.0, 0.5, 0.0, 0.0, 0.0, -1.0], [0.0] * 6
    mouse.start([{"at_s": 0.5, "twist": push, "buttons": [1]}, {"at_s": 2.5, "plugged": False},
                 {"at_s": 4.5, "plugged": True}, {"at_s": 8.0, "twist": push}], dead_band=0.0)  # fmt: skip
    gone = "SpaceMouse Compact (serial FAKE-1, /dev/hidraw-fake)"
    mouse.until_back(gone, beside=lambda: is_pushed(mouse))
    twists = [sample.twist for sample in mouse.samples if sample.twist is not None]
    deflected = [index for index, twist in enumerate(twists) if twist.any()]
    np.testing.assert_allclose(twists[deflected[0]], push, atol=0.002)
    gap = next(index for index in deflected if not twists[index + 1].any())
    assert twists[gap + 1].tolist() == rest, "the last sample before it was gone is of rest"
    assert {sample.controls["button_1"] for sample in mouse.samples} == {0.0, 1.0}
    assert mouse.facts["device"]["model"] == "SpaceMouse Compact"
    assert mouse.stop() == 0


def test_without_a_mouse_it_ends_with_one_line(mouse: Station) -> None:
    mouse.start(before="import hidraw; hidraw.enumerate = lambda vendor, product: []\n")
    assert mouse.ends() == (1, "no spacemouse found; plug one in (`lsusb` lists it as 256f:… or 046d:c6…), "
                               "wake a wireless one")  # fmt: skip


def test_without_the_library_it_names_the_extra(mouse: Station) -> None:
    mouse.start(before="import sys; sys.modules['hid'] = sys.modules['hidraw'] = None\n")
    code, words = mouse.ends()
    assert code == 1
    assert "pip install 'teleop-station[spacemouse]'" in words


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"rate_hz": 5}, "rate_hz is 5; expected 10 to 500 Hz"),
        ({"dead_band": 0.9}, "dead_band is 0.9; expected 0 to 0.5"),
        ({"scale": [1, 1, 1, 1, 1, 2]}, "expected six numbers from -1 to 1"),
        ({"scale": [1, 1]}, "scale: expected array of length 6"),
        ({"silence_s": 0.0}, "silence_s is 0; expected 0.1 to 10 s"),
        ({"seral": "x"}, "unknown key 'seral' (did you mean 'serial'?)"),
    ],
)
def test_bad_settings_are_one_line(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(SpacemouseConfig, values, where="server spacemouse")
    assert told in str(caught.value)
