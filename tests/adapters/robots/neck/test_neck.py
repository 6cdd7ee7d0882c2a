"""A neck of two servos: the real dynamixel-sdk, with the servos of a robot's twin behind a pseudo terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dynamixel_sdk", reason="needs the extra 'gello'")

from adapters.commands.hands import TWIST2_NECK
from adapters.policies.direct import DirectPolicy
from adapters.robots.g1.twin.neck import TwinNeck
from adapters.robots.neck.kind import NECK
from adapters.robots.neck.neck import DynamixelNeck
from adapters.robots.neck.options import NeckOptions
from station import assets, config
from station.bus import codec
from station.control.command_validator import CommandSample
from station.control.control import ControlStep
from station.errors import ConfigError, NotReady, StationError
from station.protocols import Floats

PERIOD_S = 0.02


class NeckBench:
    """The twin's servos, and the control step of a neck, in real time."""

    def __init__(self, folder: Path, **options: Any) -> None:
        self.twin = TwinNeck(folder)
        self.robot = DynamixelNeck(NeckOptions(port=str(self.twin.port.path), **options), PERIOD_S)
        policy = DirectPolicy(assets.resolve(NECK.checkpoint))
        self.control = ControlStep(self.robot, policy, TWIST2_NECK, is_armed=False)
        self.wanted: Floats | None = None
        self.events: list[tuple[str, str]] = []

    def step(self) -> None:
        """Make a control step."""
        now_s = time.monotonic()
        sample = CommandSample(codec.json_vector(self.wanted), now_s) if self.wanted is not None else None
        record = self.control.step(self.control.sense(), sample, now_s)
        self.events += [(each.name, str(each.detail.get("reason", ""))) for each in record.step_events]
        time.sleep(PERIOD_S / 4)

    def until(self, condition: Callable[[], bool]) -> None:
        """Make steps until something is so."""
        until_s = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < until_s, self.events
            self.step()

    @property
    def ticks(self) -> list[int]:
        return [round(servo.ticks) for servo in self.twin.servos]

    @property
    def is_stiff(self) -> list[bool]:
        return [servo.is_stiff for servo in self.twin.servos]


@pytest.fixture
def found(tmp_path: Path) -> Iterator[NeckBench]:
    made = NeckBench(tmp_path, signs=(1, -1))
    yield made
    made.robot.close()
    made.twin.close()


def test_a_neck_is_limp_until_it_is_armed_looks_where_it_is_told_and_is_limp_again(found: NeckBench) -> None:
    for _ in range(5):
        found.step()
    assert found.is_stiff == [False, False]
    assert found.control.arm(time.monotonic()) == ""
    found.until(lambda: found.control.arming.state == "armed")
    assert found.ticks == [2048, 2048]
    found.wanted = np.array([0.5, 0.3])
    goal = [2048 + round(0.5 / np.pi * 2048), 2048 - round(0.3 / np.pi * 2048)]
    found.until(lambda: np.allclose(found.ticks, goal, atol=8))
    assert found.robot.read().q == pytest.approx([0.5, 0.3], abs=0.02)
    found.wanted = np.array([1.57, 1.57])
    found.until(lambda: abs(found.ticks[0] - (2048 + round(1.4 / np.pi * 2048))) < 2)
    assert found.ticks[1] >= 2048 - round(0.8 / np.pi * 2048) - 2, "no farther than its own end"
    found.wanted = None
    held = found.ticks
    for _ in range(20):
        found.step()
    assert np.allclose(found.ticks, held, atol=8)
    found.control.disarm()
    found.until(lambda: found.is_stiff == [False, False])


def test_a_servo_that_falls_silent_and_a_cable_that_is_torn_out_are_told(found: NeckBench) -> None:
    assert found.control.arm(time.monotonic()) == ""
    found.until(lambda: found.control.arming.state == "armed")
    found.twin.servos[1].is_silent = True
    found.until(lambda: found.control.arming.state == "disarmed")
    assert "its servos have said nothing for 0." in dict(found.events)["robot-fault"]
    found.twin.servos[1].is_silent = False
    found.until(lambda: found.control.arm(time.monotonic()) == "")
    found.until(lambda: found.control.arming.state == "armed")
    found.twin.port.unplug()
    found.until(lambda: found.control.arming.state == "disarmed")
    assert "gone" in dict(found.events)["robot-fault"]
    assert "plug the neck in again" in found.control.arm(time.monotonic())


def test_a_servo_that_is_not_there_and_a_port_that_is_not_there_are_named(tmp_path: Path) -> None:
    twin = TwinNeck(tmp_path)
    try:
        with pytest.raises(NotReady, match=r"servo 7 of the neck does not answer on .* at 2000000 bit/s"):
            DynamixelNeck(NeckOptions(port=str(twin.port.path), ids=(0, 7), first_state_within_s=0.2), PERIOD_S)
    finally:
        twin.close()
    with pytest.raises(
        StationError, match=r"no such port; plug the neck in, or name another with robot_options\.port:"
    ):
        DynamixelNeck(NeckOptions(port=str(tmp_path / "none")), PERIOD_S)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ids": [1, 1]}, "two different numbers"),
        ({"signs": [1, 0]}, "expected 1 or -1"),
        ({"most_rad": [0.0, 1.0]}, "more than 0"),
    ],
)
def test_settings_that_cannot_be_are_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        config.build(NeckOptions, {"port": "/dev/ttyUSB0", **options}, where="robot neck-dynamixel")


def test_a_robot_twin_has_a_neck_where_it_is_asked_for(tmp_path: Path) -> None:
    pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")
    from adapters.robots.g1.twin.faults import G1Faults
    from adapters.robots.g1.twin.options import G1TwinOptions
    from adapters.robots.g1.twin.twin import G1Twin
    from tests.dds_domains import domain

    with domain() as number:
        twin = G1Twin(G1TwinOptions(domain=number, neck=str(tmp_path)), G1Faults())
        try:
            assert twin.health()["neck"] == {"ticks": [2048, 2048], "is_stiff": [False, False]}
            assert len(list(tmp_path.iterdir())) == 1
        finally:
            twin.close()
    assert not list(tmp_path.iterdir())
