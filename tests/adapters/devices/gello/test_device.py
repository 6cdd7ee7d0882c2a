"""Leader arms on the real dynamixel-sdk and fake servos: values, loss, faults with names, scripts."""

from __future__ import annotations

import json
import math
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.fakes.gello import FakeGello
from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.servos import Chain
from adapters.devices.gello import ports
from adapters.devices.gello.bus import RAD_PER_TICK
from adapters.devices.gello.calibration import load, save
from adapters.devices.gello.device import Gello
from station.errors import BadFile
from station.operator.device import Device, DeviceError
from station.operator.reading import Reading
from tests.adapters.devices.by_hand import HandClock
from tests.waiting import DEADLINE_S, wait_until

POSE = [0.3, -0.4, 0.5, -1.6, 0.7, 1.8, -0.9, 0.25]
OTHER = [0.0] * 7 + [1.0]

Play = Callable[..., FakeGello]
Open = Callable[..., Gello]

PATIENCE_S = 1.0
"""Far above what a busy machine takes to answer as a servo [s]: servos and adapter share this process."""


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def play(tmp_path: Path, clock: HandClock) -> Iterator[Play]:
    """Starts fake leaders that play steps."""
    fakes: list[FakeGello] = []

    def begin(*steps: dict[str, Any], period_s: float | None = None) -> FakeGello:
        file, folder = tmp_path / "script.json", tmp_path / "by-id"
        file.write_text(json.dumps({"device": "gello", "steps": steps, "period_s": period_s}))
        folder.mkdir()
        fakes.append(FakeGello(file, clock, folder))
        return fakes[-1]

    yield begin
    for fake in fakes:
        fake.close()


@pytest.fixture
def opened() -> Iterator[Open]:
    devices: list[Gello] = []

    def begin(fake: FakeGello, **options: Any) -> Gello:
        options = {
            "leaders": len(fake.leaders),
            "calibrations_folder": fake.calibrations,
            "by_id": fake.folder,
            "patience_s": PATIENCE_S,
            **options,
        }
        devices.append(Gello(**options))
        return devices[-1]

    yield begin
    for device in devices:
        device.close()


def sample(device: Gello) -> Reading:
    """Return the next new sample, of what is the case now."""
    found: list[Reading] = []

    def look() -> bool:
        reading = device.read()
        if reading is not None:
            found.append(reading)
        return len(found) >= 3  # the first may have begun before the test moved the clock

    wait_until(look)
    return found[-1]


def joints(device: Gello) -> list[float]:
    reading = sample(device)
    assert reading.joints is not None
    return [float(value) for value in reading.joints]


def near(values: list[float]) -> Any:
    return pytest.approx(values, abs=RAD_PER_TICK / math.radians(42.0) + 1e-6)


def fault(device: Gello) -> str:
    """Return how the device ends."""
    ended: list[str] = []

    def look() -> bool:
        try:
            device.read()
        except DeviceError as error:
            ended.append(str(error))
        return bool(ended)

    wait_until(look)
    return ended[0]


def test_a_leader_shows_the_joints_and_the_gripper_that_it_is_held_in(
    play: Play, opened: Open, clock: HandClock
) -> None:
    fake = play({"at_s": 0, "left": POSE}, {"at_s": 2, "left": OTHER})
    device = opened(fake)
    assert isinstance(device, Device)
    assert joints(device) == near(POSE)
    fake.begin()
    clock.pass_(1.0)
    halfway = [(a + b) / 2 for a, b in zip(POSE, OTHER, strict=True)]
    assert joints(device) == near(halfway)
    clock.pass_(5.0)
    assert joints(device) == near(OTHER)


def test_a_sample_is_given_once_and_bears_the_time_it_was_read(play: Play, opened: Open) -> None:
    device = opened(play({"at_s": 0, "left": POSE}), rate_hz=20.0)
    began_ns = time.monotonic_ns()
    captured = [reading.capture_ns for reading in (sample(device), sample(device), sample(device))]
    assert None not in captured
    assert captured == sorted(set(captured))
    assert began_ns < captured[0]
    assert captured[-1] < time.monotonic_ns()
    assert device.read() is None or device.read() is None, "two in a row cannot both be new at 20 Hz"


def test_two_leaders_are_one_sample_left_before_right(play: Play, opened: Open) -> None:
    device = opened(play({"at_s": 0, "right": OTHER, "left": POSE}))
    assert joints(device) == near(POSE[:7] + OTHER[:7] + [POSE[7], OTHER[7]])
    facts = device.facts()
    assert [leader["arm"] for leader in facts["leaders"]] == ["left", "right"]
    assert facts["joints"][:2] == ["left_joint_1", "left_joint_2"]
    assert facts["joints"][6:8] == ["left_joint_7", "right_joint_1"]
    assert facts["joints"][14:] == ["left_gripper", "right_gripper"]


def test_a_sample_of_two_leaders_is_as_old_as_the_older_one(play: Play, opened: Open) -> None:
    fake = play({"at_s": 0, "left": POSE, "right": OTHER})
    device = opened(fake, patience_s=DEADLINE_S)
    sample(device)
    fake.leaders[1].servos[3].is_silent = True
    captured = [sample(device).capture_ns for _ in range(5)]
    assert captured[-1] == captured[-2], "only the left one is still read"


def test_servos_that_lost_count_of_their_turns_are_brought_back(play: Play, opened: Open, clock: HandClock) -> None:
    held = [2.5, -2.5, 2.5, -2.5, 2.5, -2.5, 2.5, 0.5]
    fake = play({"at_s": 0, "left": held}, {"at_s": 1, "power_cycled": True})
    fake.begin()
    clock.pass_(2.0)
    assert joints(opened(fake)) == near(held)


def test_a_silent_servo_is_a_fault_with_its_name_and_no_old_joints_follow(
    play: Play, opened: Open, clock: HandClock
) -> None:
    fake = play({"at_s": 0, "left": POSE, "right": OTHER}, {"at_s": 1, "silent": [4], "arm": "right"})
    device = opened(fake)
    joints(device)
    fake.begin()
    clock.pass_(1.0)
    said = "leader FAKE-RIGHT: servo 4 (joint_4) is silent; see to its cable and to the one before it"
    wait_until(lambda: fault(device) == said)  # on a busy machine another servo's answer may come too late as well
    for _ in range(3):
        with pytest.raises(DeviceError):
            device.read()
    assert "joint_4" in device.why_silent()
    device.close()
    with pytest.raises(DeviceError, match=r"no answer from servo 4 \(joint_4\); 1, 2, 3, 5, 6, 7, 8 of 8 answer"):
        opened(fake)


def test_a_leader_without_power_is_named(play: Play, opened: Open, clock: HandClock) -> None:
    fake = play({"at_s": 0, "left": POSE}, {"at_s": 1, "silent": list(range(1, 9))})
    device = opened(fake)
    joints(device)
    fake.begin()
    clock.pass_(1.0)
    assert fault(device) == "leader FAKE-LEFT: every servo is silent; see to its power and to the cable of the first"
    device.close()
    with pytest.raises(DeviceError, match="no servo answers at any baud rate; see to the leader's power"):
        opened(fake)


def test_torn_answers_are_read_again(play: Play, opened: Open, clock: HandClock) -> None:
    fake = play({"at_s": 0, "left": POSE}, {"at_s": 1, "broken": 1})
    device = opened(fake, patience_s=DEADLINE_S)
    joints(device)
    fake.begin()
    clock.pass_(1.0)
    wait_until(lambda: device._samplers[0].failures > 0)
    assert joints(device) == near(POSE)


def test_answers_that_stay_torn_are_a_fault(play: Play, opened: Open, clock: HandClock) -> None:
    fake = play({"at_s": 0, "left": POSE}, {"at_s": 1, "broken": 1_000_000, "arm": "left"})
    device = opened(fake)
    fake.leaders[0].port._chain.servos[2]._position = lambda: 0  # still answers pings
    fake.begin()
    clock.pass_(1.0)
    assert "is silent" in fault(device) or "torn answers" in fault(device)


def test_a_port_that_is_torn_out_is_gone_and_found_again(play: Play, opened: Open, clock: HandClock) -> None:
    fake = play({"at_s": 0, "left": POSE}, {"at_s": 1, "plugged": False}, {"at_s": 2, "plugged": True})
    device = opened(fake)
    joints(device)
    fake.begin()
    clock.pass_(1.0)
    assert "gone" in fault(device)
    device.close()
    with pytest.raises(DeviceError, match="no leader found"):
        opened(fake)
    clock.pass_(1.0)
    wait_until(fake.leaders[0].port.path.exists)
    assert joints(opened(fake)) == near(POSE)


def test_a_read_returns_at_once_while_the_bus_waits(play: Play, opened: Open, clock: HandClock) -> None:
    fake = play({"at_s": 0, "left": POSE})
    device = opened(fake, patience_s=DEADLINE_S)
    joints(device)
    fake.leaders[0].servos[3].is_silent = True
    failures = device._samplers[0].failures
    calls = 0
    while device._samplers[0].failures < failures + 2:  # each of them holds the library for 44 ms
        device.read()
        calls += 1
    assert calls > 100


def test_another_baud_rate_is_named(play: Play, opened: Open) -> None:
    fake = play({"at_s": 0, "left": POSE})
    leader = fake.leaders[0]
    leader.port.close()
    leader.port = FakePort(fake.folder, leader.serial, Chain(leader.servos), baud=termios.B1000000)
    with pytest.raises(DeviceError, match="no servo answers at 57600 baud, but they do at 1000000: set baud: 1000000"):
        opened(fake)
    assert joints(opened(fake, baud=1_000_000)) == near(POSE)


def test_the_calibration_of_another_leader_is_refused(play: Play, opened: Open) -> None:
    fake = play({"at_s": 0, "left": POSE})
    (fake.calibrations / "FAKE-LEFT.yaml").rename(fake.calibrations / "other.yaml")
    with pytest.raises(DeviceError, match="leader FAKE-LEFT has no calibration"):
        opened(fake)
    (fake.calibrations / "FAKE-LEFT.yaml").write_text(
        (fake.calibrations / "other.yaml").read_text().replace("FAKE-LEFT", "FT99")
    )
    with pytest.raises(BadFile, match="is the calibration of leader FT99, expected that of FAKE-LEFT"):
        opened(fake)


def test_two_leaders_of_the_same_arm_are_refused(play: Play, opened: Open) -> None:
    fake = play({"at_s": 0, "left": POSE, "right": POSE})
    right = load(fake.calibrations, "FAKE-RIGHT")
    save(fake.calibrations, type(right)(serial=right.serial, arm="left", date=right.date, joints=right.joints,
                                        gripper=right.gripper))  # fmt: skip
    with pytest.raises(DeviceError, match="FAKE-LEFT and FAKE-RIGHT are both calibrated as the left arm"):
        opened(fake)
    assert joints(opened(fake, leaders=1, ports_wanted=(str(fake.leaders[0].port.path),))) == near(POSE)


def test_numbers_of_ports_are_checked(play: Play, opened: Open, tmp_path: Path) -> None:
    fake = play({"at_s": 0, "left": POSE, "right": POSE})
    with pytest.raises(DeviceError, match=r"2 adapters found, 1 wanted: .*FAKE-LEFT.*FAKE-RIGHT.*choose with ports:"):
        opened(fake, leaders=1)
    with pytest.raises(DeviceError, match="1 ports for 2 leaders"):
        opened(fake, ports_wanted=("/dev/ttyUSB0",))
    with pytest.raises(DeviceError, match=r"no leader found: no usb-FTDI.* plug its U2D2 in, or name another port"):
        ports.choose((), 1, tmp_path / "none")
