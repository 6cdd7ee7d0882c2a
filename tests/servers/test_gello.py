"""The GELLO server as a process of its own: the makers' real libraries, servos on pseudo terminals, and a real bus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.devices.gello.kind import GelloConfig
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.servers.device_station import Station, station

POSE, OTHER = [0.3, -0.4, 0.5, -1.6, 0.7, 1.8, -0.9, 0.0], [0.0] * 7 + [1.0]


@pytest.fixture
def leaders(bus_server: BusAddress, tmp_path: Path) -> Iterator[Station]:
    with station("gello", bus_server, tmp_path) as made:
        yield made


def test_two_leaders_stand_on_the_bus_and_a_silent_servo_is_named_until_it_answers(leaders: Station) -> None:
    steps = [{"at_s": 0.0, "left": POSE, "right": OTHER}, {"at_s": 1.0, "left": POSE}, {"at_s": 1.5, "left": OTHER},
             {"at_s": 2.0, "silent": [4], "arm": "left"}, {"at_s": 4.5, "silent": []}]  # fmt: skip
    leaders.start(steps, patience_s=1.0)
    leaders.until(lambda: leaders.lasting()[-2:] == ["lost", "live"] and len(leaders.samples) > 100)
    joints = [sample.joints for sample in leaders.samples if sample.joints is not None]
    np.testing.assert_allclose(joints[0], [*POSE[:7], *OTHER[:7], POSE[7], OTHER[7]], atol=0.01)
    np.testing.assert_allclose(joints[-1], [*OTHER[:7], *OTHER[:7], OTHER[7], OTHER[7]], atol=0.01)
    captured = [sample.capture_ns or 0 for sample in leaders.samples]
    assert captured == sorted(set(captured)), "no old joints are given again"
    faults = [str(event.detail) for event in leaders.events if event.name == "operator-lost"]
    assert any("joint_4" in fault for fault in faults)
    assert leaders.facts["device"]["joints"][14:] == ["left_gripper", "right_gripper"]
    assert "fake_began_wall_ns" in leaders.facts
    assert leaders.stop() == 0


def test_a_leader_of_feetech_stands_on_the_bus_with_joints_that_never_jump(leaders: Station) -> None:
    away = [0.5, -0.5, 0.5, -0.5, 0.5, 1.0]
    steps = [{"at_s": 0.0, "servos": "feetech", "left": [0.0] * 6}, {"at_s": 1.0, "left": away},
             {"at_s": 2.0, "left": [-each for each in away[:5]] + [0.0]}, {"at_s": 3.0, "silent": [4]}]  # fmt: skip
    leaders.start(steps, servos="feetech")
    leaders.until(lambda: leaders.lasting()[-1:] == ["lost"])
    joints = np.array([sample.joints for sample in leaders.samples if sample.joints is not None])
    np.testing.assert_allclose(joints[0], 0.0, atol=0.01)
    np.testing.assert_allclose(joints[-1], [*(-each for each in away[:5]), 0.0], atol=0.01)
    assert np.abs(joints[:, :5]).max() < 0.51
    assert any("joint_4" in str(event.detail) for event in leaders.events if event.name == "operator-lost")
    assert leaders.facts["device"]["servos"] == "feetech"
    assert leaders.stop() == 0


def test_without_a_leader_it_ends_with_one_line(leaders: Station) -> None:
    leaders.start(ports=["/dev/ttyNONE"])
    code, words = leaders.ends()
    assert code == 1
    assert words.startswith("leader ttyNONE has no calibration (")
    assert words.endswith("; make one: station devices calibrate gello")


@pytest.mark.parametrize(("servos", "module"), [("dynamixel", "dynamixel_sdk"), ("feetech", "scservo_sdk")])
def test_without_the_library_it_names_the_extra(leaders: Station, servos: str, module: str) -> None:
    steps = [{"at_s": 0, "left": POSE, "servos": servos}]
    leaders.start(steps, before=f"import sys; sys.modules[{module!r}] = None\n", servos=servos)
    code, words = leaders.ends()
    assert code == 1
    assert "pip install 'teleop-station[gello]'" in words


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"leaders": 3}, "leaders is 3; expected 1 or 2"),
        ({"leaders": 2, "ports": ["/dev/ttyUSB0"]}, "1 ports for 2 leaders"),
        ({"baud": 9600}, "baud is 9600; expected one of 57600, 1000000"),
        ({"baud": 57601, "servos": "feetech"}, "expected one of 1000000, 500000, 250000, 128000, 115200, 57600, 38400"),
        ({"baud": 2000000, "servos": "feetech"}, "for servos of feetech"),
        ({"servos": "feetec"}, "servos: expected dynamixel or feetech, got 'feetec' (did you mean 'feetech'?)"),
        ({"rate_hz": 1000}, "rate_hz is 1000; expected 10 to 200 Hz"),
        ({"patience_s": 60}, "patience_s is 60; expected 0.05 to 5 s"),
    ],
)
def test_bad_settings_are_one_line(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(GelloConfig, values, where="server gello")
    assert told in str(caught.value)
