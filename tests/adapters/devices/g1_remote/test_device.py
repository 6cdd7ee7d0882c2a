"""A G1's remote as the twin of the robot sends it, read as an operator's device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.devices.g1_remote.device import G1Remote
from adapters.devices.g1_remote.kind import G1RemoteConfig
from adapters.robots.g1.dds.options import NetworkOptions
from adapters.robots.g1.dds.remote import STOPS
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.g1.twin.options import G1TwinOptions
from adapters.robots.g1.twin.twin import G1Twin
from station import config
from station.errors import ConfigError
from station.operator.buttons import Buttons, button_map
from station.operator.device import DeviceError
from tests.dds_domains import domain


class Both:
    """The twin, and the device that hears its remote."""

    def __init__(self, number: int) -> None:
        self.twin = G1Twin(G1TwinOptions(domain=number), G1Faults())
        self.device = G1Remote(NetworkOptions(domain=number), dead_band=0.05)

    def shown(self, looks: int = 6, **faults: Any) -> dict[str, float] | None:
        """Return what the last of some looks shows, ten milliseconds apart, of a twin with faults."""
        self.twin.change(G1Faults(**faults))
        sample = None
        for _ in range(looks):
            for _ in range(5):
                self.twin.tick()
            sample = self.device.read()
        return dict(sample.controls) if sample is not None else None

    def close(self) -> None:
        self.device.close()
        self.twin.close()


@pytest.fixture
def both() -> Iterator[Both]:
    with domain() as number, closing(Both(number)) as found:
        yield found


def test_sticks_and_buttons_have_the_names_of_a_gamepads(both: Both) -> None:
    shown = both.shown(sticks=(0.03, 0.0, -0.5, 0.0), remote=("L1", "A", "F2"))
    assert shown is not None
    assert {name for name, value in shown.items() if value} == {
        "right_stick_x", "left_bumper", "right_primary", "right_stick_click"
    }  # fmt: skip
    assert shown["right_stick_x"] == pytest.approx(-0.474, abs=0.01)
    rested = both.shown()
    assert rested is not None
    assert not any(rested.values())


@pytest.mark.parametrize("stop", STOPS, ids=lambda stop: "+".join(sorted(stop)))
def test_what_stops_the_robot_stops_the_station_too(both: Both, stop: frozenset[str]) -> None:
    buttons = Buttons(button_map("g1-remote"))
    assert buttons.step(both.shown(), 0.01).started == frozenset()
    assert buttons.step(both.shown(remote=tuple(stop)), 0.01).started == {"estop"}


def test_a_remote_that_is_off_a_robot_that_is_silent_and_an_interface_that_is_not_there_are_told(both: Both) -> None:
    assert both.shown() is not None
    assert both.shown(remote_off=True) is None
    assert both.device.why_silent() == "the robot is heard and its remote is off; switch it on"
    assert both.shown(state_silent=True) is None
    with pytest.raises(DeviceError, match="interface 'nosuch0': DDS cannot use it"):
        G1Remote(NetworkOptions(interface="nosuch0", domain=201), dead_band=0.05)
    with domain() as number, closing(G1Remote(NetworkOptions(domain=number), 0.05)) as alone:
        assert alone.read() is None
        assert alone.why_silent().startswith(f"no state of a G1 on lo, domain {number}")


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"dead_band": 0.9}, "expected 0 to 0.5"),
     ({"domain": 999}, "expected 0 to 230")],
)  # fmt: skip
def test_settings_that_cannot_be_are_named(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        config.build(G1RemoteConfig, settings, where="server g1-remote")
