"""The glove server as a process of its own: the real pyserial, a glove on a pseudo terminal, and a real bus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.devices.glove.kind import GloveConfig
from adapters.devices.glove.sensors import FINGERS
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.servers.device_station import Station, station

FLAT, FIST = [0.0] * 5, [1.0] * 5


@pytest.fixture
def glove(bus_server: BusAddress, tmp_path: Path) -> Iterator[Station]:
    with station("glove", bus_server, tmp_path) as made:
        yield made


def test_a_hand_stands_on_the_bus_and_silence_is_named_until_it_is_over(glove: Station) -> None:
    steps = [{"at_s": 0.0, "left": FLAT, "right": FIST, "protocol": "opengloves"}, {"at_s": 1.0, "left": FLAT},
             {"at_s": 1.2, "garbage": 3}, {"at_s": 1.3, "cut": 2}, {"at_s": 1.5, "left": FIST},
             {"at_s": 2.0, "silent": True}, {"at_s": 4.5, "silent": False}]  # fmt: skip
    glove.start(steps, side="left", patience_s=1.0)
    glove.until(lambda: glove.lasting()[-2:] == ["lost", "live"] and len(glove.samples) > 100)
    joints = [sample.joints for sample in glove.samples if sample.joints is not None]
    np.testing.assert_allclose(joints[0], FLAT, atol=0.001)
    np.testing.assert_allclose(joints[-1], FIST, atol=0.001)
    captured = [sample.capture_ns or 0 for sample in glove.samples]
    assert captured == sorted(set(captured)), "no old line is given again"
    faults = [str(event.detail) for event in glove.events if event.name == "operator-lost"]
    assert any("nothing comes from the left glove FAKE-LEFT; see to its power and cable" in fault for fault in faults)
    assert glove.facts["device"]["joints"] == list(FINGERS)
    assert "fake_began_wall_ns" in glove.facts
    assert glove.stop() == 0


def test_without_a_glove_it_ends_with_one_line(glove: Station) -> None:
    glove.start(port="/dev/ttyNONE")
    code, words = glove.ends()
    assert code == 1
    assert words.startswith("glove ttyNONE has no calibration for the right hand (")
    assert words.endswith("; make one: station devices calibrate glove --side right")


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"side": "both"}, "side"),
        ({"baud": 0}, "baud is 0; expected 1200 to 4000000"),
        ({"rate_hz": 1000}, "rate_hz is 1000; expected 10 to 500 Hz"),
        ({"patience_s": 60}, "patience_s is 60; expected 0.05 to 5 s"),
        ({"protocol": "morse"}, "protocol"),
    ],
)
def test_bad_settings_are_one_line(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(GloveConfig, values, where="server glove")
    assert told in str(caught.value)
