"""Calibrating a leader with a person who does, in the end, what is asked."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.devices.fakes.gello.servos import SERVOS, Chain, FeetechServo, wrapped
from adapters.devices.gello.bus import BUSES, RAD_PER_TICK, FeetechBus, MotorBus, model_name
from adapters.devices.gello.calibrate import SIGNS, Plan, calibrate, calibrate_port
from adapters.devices.gello.calibration import QUARTER, Calibration, load
from station.operator.device import DeviceError
from tests.adapters.devices.gello.serial_line import lines_in_memory
from tests.virtual.clock import VirtualClock

NAMES = ("base", "shoulder", "elbow")
POSE = (0.0, -math.pi / 2, math.pi / 2)
OFFSETS = (2 * QUARTER, -3 * QUARTER, 5 * QUARTER)
TURNS = (1, -1, -1)


class Person:
    """Holds a leader, and does what is asked for; the first time not always."""

    def __init__(self, *, is_careless: bool = False) -> None:
        self.joints, self.gripper = [0.4, 0.4, 0.4], 0.3
        self.said: list[str] = []
        self.asked: list[str] = []
        self._careless_of = {"Turn elbow", "Hold the leader", "Pull the trigger"} if is_careless else set()

    def ticks(self, index: int) -> int:
        if index == len(NAMES):
            return round(math.radians(200.0 - 42.0 * self.gripper) / RAD_PER_TICK)
        return round((OFFSETS[index] + TURNS[index] * self.joints[index]) / RAD_PER_TICK)

    def show(self, line: str) -> None:
        self.said.append(line)

    def ask(self, question: str) -> str:
        self.asked.append(question)
        for begin in self._careless_of:
            if question.startswith(begin):
                self._careless_of.discard(begin)
                return ""
        if match := re.match(r"Turn (\w+) by", question):
            self.joints[NAMES.index(match[1])] += 0.5
        elif question.startswith("Hold the leader still"):
            self.joints = [q + 0.08 for q in POSE]
        else:
            self.gripper = 0.0 if "fully open" in question else 1.0
        return ""


@pytest.fixture
def person() -> Person:
    return Person()


@pytest.fixture(params=BUSES)
def bus(person: Person, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[MotorBus]:
    kind, servo, shown = BUSES[request.param], SERVOS[request.param], wrapped if request.param == "feetech" else int
    servos = [servo(index + 1, lambda index=index: shown(person.ticks(index))) for index in range(len(NAMES) + 1)]
    with VirtualClock() as clock, lines_in_memory(clock) as line:
        port = line(tmp_path, "FT1", Chain(servos))
        opened = kind(str(port.path), kind.bauds[0], clock)
        yield opened
        opened.close()
        port.close()


def expect_offsets(bus: MotorBus, made: Calibration) -> None:
    """Expect those of the leader; whole turns are nothing to a servo that begins anew after each."""
    off = [joint.offset_rad - offset for joint, offset in zip(made.joints, OFFSETS, strict=True)]
    if bus.servos == "feetech":
        off = [math.remainder(each, math.tau) for each in off]
    assert off == pytest.approx([0.0] * len(NAMES))


def test_signs_offsets_and_gripper_are_found_and_kept(bus: MotorBus, person: Person, tmp_path: Path) -> None:
    file = calibrate(bus, "FT1", Plan("right", NAMES, POSE), person, tmp_path / "kept")
    made = load(tmp_path / "kept", "FT1")
    assert file == tmp_path / "kept" / "FT1.yaml"
    assert [joint.sign for joint in made.joints] == list(TURNS)
    expect_offsets(bus, made)
    assert {joint.model for joint in made.joints} <= set(bus.models)
    assert [joint.reference_rad for joint in made.joints] == pytest.approx(POSE)
    assert made.gripper is not None
    assert math.degrees(made.gripper.open_rad) == pytest.approx(200.0, abs=0.1)
    assert math.degrees(made.gripper.closed_rad) == pytest.approx(158.0, abs=0.1)
    assert made.names == ("right_base", "right_shoulder", "right_elbow", "right_gripper")
    assert "base 0°, shoulder -90°, elbow 90°" in " ".join(person.asked)
    shown = bus.positions(made.ids)
    assert shown is not None
    values = made.values(shown, made.turns(shown))
    assert values[:3].tolist() == pytest.approx(person.joints, abs=2e-3)


def test_what_was_not_done_is_asked_again(bus: MotorBus, person: Person, tmp_path: Path) -> None:
    person._careless_of = {"Turn elbow", "Hold the leader", "Pull the trigger"}
    calibrate(bus, "FT1", Plan("left", NAMES, POSE), person, tmp_path)
    assert [joint.sign for joint in load(tmp_path, "FT1").joints] == list(TURNS)
    told = " ".join(person.said)
    assert "elbow: servo 3 has moved by" in told
    assert "more than 20° from the pose, so the quarter turn is doubtful; once more" in told
    assert "the trigger has moved by" in told


def test_known_signs_are_not_asked_for(bus: MotorBus, person: Person, tmp_path: Path) -> None:
    calibrate(bus, "FT1", Plan("left", NAMES, POSE, signs=TURNS), person, tmp_path)
    assert not [question for question in person.asked if question.startswith("Turn")]
    expect_offsets(bus, load(tmp_path, "FT1"))


def test_a_port_is_calibrated_under_the_serial_number_in_its_name(
    bus: MotorBus, person: Person, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    bus.close()
    plan = Plan("left", NAMES, POSE, signs=TURNS)
    file = calibrate_port(bus.port, plan, person, servos=bus.servos, clock=bus.clock)
    assert file == tmp_path / "settings" / "station" / "gello" / "FT1.yaml"
    type(bus)(bus.port, bus.baud, bus.clock).close()  # the port was let go of


def test_servos_that_do_not_fit_the_plan_are_listed(bus: MotorBus, person: Person, tmp_path: Path) -> None:
    usual = model_name(bus.scan()[1])
    assert usual == {"dynamixel": "XL330-M288", "feetech": "STS3215"}[bus.servos]
    with pytest.raises(DeviceError, match=rf"4 servos answer at {bus.baud} baud \(1 \({usual}\).*\), expected 3"):
        calibrate(bus, "FT1", Plan("left", NAMES, POSE, has_gripper=False), person, tmp_path)
    assert not list(tmp_path.glob("*.yaml"))


def test_a_joint_that_trembles_where_its_servo_begins_anew_is_held_still(tmp_path: Path) -> None:
    looks = itertools.count()
    servo = FeetechServo(1, lambda: wrapped(next(looks) % 3 - 1))
    person = Person()
    with VirtualClock() as clock, lines_in_memory(clock) as line:
        port = line(tmp_path, "FT1", Chain([servo]))
        bus = FeetechBus(str(port.path), 1_000_000, clock)
        calibrate(bus, "FT1", Plan("left", ("base",), (0.0,), signs=(1,), has_gripper=False), person, tmp_path)
        bus.close()
        port.close()
    assert len(person.asked) == 1, "not whether it is held still"
    assert load(tmp_path, "FT1").joints[0].offset_rad % math.tau == pytest.approx(0.0)


def test_a_plan_that_does_not_agree_with_itself_is_refused() -> None:
    with pytest.raises(DeviceError, match="2 numbers of the pose for 3 joints"):
        Plan("left", NAMES, (0.0, 0.0))
    with pytest.raises(DeviceError, match="6 numbers of the signs for 3 joints"):
        Plan("left", NAMES, POSE, signs=SIGNS["ur"])
