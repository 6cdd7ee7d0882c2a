"""Leader arms on real libraries and fake servos, in virtual time: values, loss, faults with names, scripts."""

from __future__ import annotations

import importlib
import json
import math
import random
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.devices.fakes.gello import FakeGello
from adapters.devices.fakes.gello.servos import Chain
from adapters.devices.gello import ports
from adapters.devices.gello.bus import RAD_PER_TICK
from adapters.devices.gello.calibration import load, save
from adapters.devices.gello.device import Gello
from station.errors import BadFile
from station.operator.device import Device, DeviceError
from station.operator.sample import OperatorSample
from tests.adapters.devices.gello.serial_line import LinePort, lines_in_memory
from tests.examples import some
from tests.virtual.clock import VirtualClock
from tests.waiting import DEADLINE_S

POSE = [0.3, -0.4, 0.5, -1.6, 0.7, 1.8, -0.9, 0.25]
OTHER = [0.0] * 7 + [1.0]


class Bench:
    """A table with leaders, in virtual time."""

    def __init__(self, clock: VirtualClock, port: Callable[..., LinePort], folder: Path) -> None:
        self.clock, self.port, self._folder = clock, port, folder
        self._fakes: list[FakeGello] = []
        self._devices: list[Gello] = []

    def play(self, *steps: dict[str, Any], period_s: float | None = None) -> FakeGello:
        """Start fake leaders that play steps."""
        file, folder = self._folder / "script.json", self._folder / "by-id"
        file.write_text(json.dumps({"device": "gello", "steps": steps, "period_s": period_s}))
        folder.mkdir()
        self._fakes.append(FakeGello(file, self.clock.monotonic_s, folder))
        return self._fakes[-1]

    def open(self, fake: FakeGello, **options: Any) -> Gello:
        options = {
            "leaders": len(fake.leaders),
            "calibrations_folder": fake.calibrations,
            "by_id": fake.folder,
            "servos": fake.servos,
            "clock": self.clock,
            **options,
        }
        self._devices.append(Gello(**options))
        return self._devices[-1]

    def until(self, condition: Callable[[], bool]) -> None:
        end_s = self.clock.monotonic_s() + DEADLINE_S
        while not condition():
            assert self.clock.monotonic_s() < end_s
            self.clock.sleep(0.001)

    def sample(self, device: Gello) -> OperatorSample:
        """Return the next new sample, of what is the case now."""
        begun_ns, found = self.clock.monotonic_ns(), [device.read()]

        def is_new() -> bool:
            found.append(device.read() or found[-1])
            reading = found[-1]
            return reading is not None and reading.capture_ns is not None and reading.capture_ns > begun_ns

        self.until(is_new)
        assert found[-1] is not None
        return found[-1]

    def joints(self, device: Gello) -> list[float]:
        reading = self.sample(device)
        assert reading.joints is not None
        return [float(value) for value in reading.joints]

    def fault(self, device: Gello) -> str:
        """Return how the device ends."""
        ended: list[str] = []

        def look() -> bool:
            try:
                device.read()
            except DeviceError as error:
                ended.append(str(error))
            return bool(ended)

        self.until(look)
        return ended[0]

    def close(self) -> None:
        for device in self._devices:
            device.close()
        for fake in self._fakes:
            fake.close()


@contextmanager
def bench_in(folder: Path, seed: int) -> Iterator[Bench]:
    with VirtualClock(seed, late_ns=1_000_000) as clock, lines_in_memory(clock) as port:
        made = Bench(clock, port, folder)
        try:
            yield made
        finally:
            made.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path, seed=1) as made:
        yield made


def near(values: list[float]) -> Any:
    return pytest.approx(values, abs=RAD_PER_TICK / math.radians(42.0) + 1e-6)


def test_a_leader_shows_the_joints_and_the_gripper_that_it_is_held_in(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE}, {"at_s": 2, "left": OTHER})
    device = bench.open(fake)
    assert isinstance(device, Device)
    assert bench.joints(device) == near(POSE)
    fake.begin()
    began_ns = bench.clock.monotonic_ns()
    bench.clock.sleep(1.0)
    reading = bench.sample(device)
    assert reading.capture_ns is not None
    share = (reading.capture_ns - began_ns) * 1e-9 / 2.0
    assert 0.5 < share < 0.51
    assert reading.joints == near([a + (b - a) * share for a, b in zip(POSE, OTHER, strict=True)])
    bench.clock.sleep(5.0)
    assert bench.joints(device) == near(OTHER)


def test_a_sample_is_given_once_and_bears_the_time_it_was_read(bench: Bench) -> None:
    device = bench.open(bench.play({"at_s": 0, "left": POSE}), rate_hz=20.0)
    captured_ns: list[int] = []
    for _ in range(5):
        began_ns = bench.clock.monotonic_ns()
        reading = bench.sample(device)
        assert device.read() is None, "it was given"
        assert reading.capture_ns is not None
        assert began_ns <= reading.capture_ns <= bench.clock.monotonic_ns()
        captured_ns.append(reading.capture_ns)
    assert np.diff(captured_ns) * 1e-9 == pytest.approx(0.05, abs=0.003)


def test_two_leaders_are_one_sample_left_before_right(bench: Bench) -> None:
    device = bench.open(bench.play({"at_s": 0, "right": OTHER, "left": POSE}))
    assert bench.joints(device) == near(POSE[:7] + OTHER[:7] + [POSE[7], OTHER[7]])
    facts = device.facts()
    assert [leader["arm"] for leader in facts["leaders"]] == ["left", "right"]
    assert facts["joints"][:2] == ["left_joint_1", "left_joint_2"]
    assert facts["joints"][6:8] == ["left_joint_7", "right_joint_1"]
    assert facts["joints"][14:] == ["left_gripper", "right_gripper"]


def test_a_sample_of_two_leaders_is_as_old_as_the_older_one(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE, "right": OTHER})
    device = bench.open(fake, patience_s=DEADLINE_S)
    bench.sample(device)
    fake.leaders[1].servos[3].is_silent = True
    bench.clock.sleep(0.05)
    now_ns, captured = bench.clock.monotonic_ns(), []
    for _ in range(100):
        if (reading := device.read()) is not None:
            captured.append(reading.capture_ns)
        bench.clock.sleep(0.01)
    assert len(captured) > 10, "the left one is still read"
    assert len(set(captured)) == 1
    assert (captured[0] or 0) < now_ns


def test_servos_that_lost_count_of_their_turns_are_brought_back(bench: Bench) -> None:
    held = [2.5, -2.5, 2.5, -2.5, 2.5, -2.5, 2.5, 0.5]
    fake = bench.play({"at_s": 0, "left": held}, {"at_s": 1, "power_cycled": True})
    fake.begin()
    bench.clock.sleep(2.0)
    assert bench.joints(bench.open(fake)) == near(held)


def test_a_silent_servo_is_a_fault_with_its_name_and_no_old_joints_follow(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE, "right": OTHER}, {"at_s": 1, "silent": [4], "arm": "right"})
    device = bench.open(fake)
    bench.joints(device)
    fake.begin()
    bench.clock.sleep(1.0)
    said = "leader FAKE-RIGHT: servo 4 (joint_4) is silent; see to its cable and to the one before it"
    silent_s = bench.clock.monotonic_s()
    assert bench.fault(device) == said
    assert 0.2 < bench.clock.monotonic_s() - silent_s < 0.8, "a quarter of a second, and the pings of the diagnosis"
    for _ in range(3):
        with pytest.raises(DeviceError):
            device.read()
    assert "joint_4" in device.why_silent()
    device.close()
    with pytest.raises(DeviceError, match=r"no answer from servo 4 \(joint_4\); 1, 2, 3, 5, 6, 7, 8 of 8 answer"):
        bench.open(fake)


def test_a_leader_without_power_is_named(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE}, {"at_s": 1, "silent": list(range(1, 9))})
    device = bench.open(fake)
    bench.joints(device)
    fake.begin()
    bench.clock.sleep(1.0)
    assert (
        bench.fault(device) == "leader FAKE-LEFT: every servo is silent; see to its power and to the cable of the first"
    )
    device.close()
    with pytest.raises(DeviceError, match="no servo answers at any baud rate; see to the leader's power"):
        bench.open(fake)


def test_torn_answers_are_read_again(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE}, {"at_s": 1, "broken": 1})
    device = bench.open(fake, patience_s=DEADLINE_S)
    bench.joints(device)
    fake.begin()
    bench.clock.sleep(1.0)
    bench.until(lambda: device._samplers[0].failures > 0)
    assert bench.joints(device) == near(POSE)


def test_answers_that_stay_torn_are_a_fault(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE}, {"at_s": 1, "broken": 1_000_000, "arm": "left"})
    device = bench.open(fake)
    fake.leaders[0].port._chain.servos[2]._position = lambda: 0  # still answers pings
    fake.begin()
    bench.clock.sleep(1.0)
    assert "is silent" in bench.fault(device) or "torn answers" in bench.fault(device)


def test_a_port_that_is_torn_out_is_gone_and_found_again(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE}, {"at_s": 1, "plugged": False}, {"at_s": 2, "plugged": True})
    device = bench.open(fake)
    bench.joints(device)
    fake.begin()
    bench.clock.sleep(1.0)
    assert "gone" in bench.fault(device)
    device.close()
    with pytest.raises(DeviceError, match="no leader found"):
        bench.open(fake)
    bench.clock.sleep(1.0)
    bench.until(fake.leaders[0].port.path.exists)
    assert bench.joints(bench.open(fake)) == near(POSE)


def test_a_read_returns_at_once_while_the_bus_waits(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE})
    device = bench.open(fake, patience_s=DEADLINE_S)
    bench.joints(device)
    fake.leaders[0].servos[3].is_silent = True
    failures = device._samplers[0].failures
    while device._samplers[0].failures < failures + 2:  # each of them holds the library for 44 ms
        began_ns = bench.clock.monotonic_ns()
        device.read()
        assert bench.clock.monotonic_ns() == began_ns
        bench.clock.sleep(0.001)


def test_another_baud_rate_is_named(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE})
    leader = fake.leaders[0]
    leader.port.close()
    leader.port = bench.port(fake.folder, leader.serial, Chain(leader.servos), baud=termios.B1000000)
    with pytest.raises(DeviceError, match="no servo answers at 57600 baud, but they do at 1000000: set baud: 1000000"):
        bench.open(fake)
    assert bench.joints(bench.open(fake, baud=1_000_000)) == near(POSE)


def test_the_calibration_of_another_leader_is_refused(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE})
    (fake.calibrations / "FAKE-LEFT.yaml").rename(fake.calibrations / "other.yaml")
    with pytest.raises(DeviceError, match="leader FAKE-LEFT has no calibration"):
        bench.open(fake)
    (fake.calibrations / "FAKE-LEFT.yaml").write_text(
        (fake.calibrations / "other.yaml").read_text().replace("FAKE-LEFT", "FT99")
    )
    with pytest.raises(BadFile, match="is the calibration of leader FT99, expected that of FAKE-LEFT"):
        bench.open(fake)


def test_two_leaders_of_the_same_arm_are_refused(bench: Bench) -> None:
    fake = bench.play({"at_s": 0, "left": POSE, "right": POSE})
    right = load(fake.calibrations, "FAKE-RIGHT")
    save(fake.calibrations, type(right)(serial=right.serial, arm="left", date=right.date, joints=right.joints,
                                        gripper=right.gripper))  # fmt: skip
    with pytest.raises(DeviceError, match="FAKE-LEFT and FAKE-RIGHT are both calibrated as the left arm"):
        bench.open(fake)
    assert bench.joints(bench.open(fake, leaders=1, ports_wanted=(str(fake.leaders[0].port.path),))) == near(POSE)


FEETECH = {"at_s": 0, "servos": "feetech"}


def test_a_leader_of_feetech_shows_its_joints_through_the_place_where_its_servos_begin_anew(bench: Bench) -> None:
    there, back = [1.0, -1.5, 1.5, -1.0, 0.5, 0.0], [-1.0, 1.5, -1.5, 1.0, -0.5, 1.0]  # joint 4 is zero at a whole turn
    fake = bench.play({**FEETECH, "left": there}, {"at_s": 1, "left": back}, period_s=2.0)
    device = bench.open(fake)
    assert bench.joints(device) == near(there)
    fake.begin()
    began_ns, ticks, shown = bench.clock.monotonic_ns(), [], []
    for _ in range(300):
        reading = bench.sample(device)
        ticks.append(fake.leaders[0].servos[3]._position())
        share = abs((reading.capture_ns - began_ns) * 1e-9 % 2.0 - 1.0)
        assert reading.joints == pytest.approx(
            [b + (a - b) * share for a, b in zip(there, back, strict=True)], abs=0.03
        )
        shown.append(reading.joints[3])
    assert np.abs(np.diff(ticks)).max() > 4000, "its servo began anew"
    assert np.abs(np.diff(shown)).max() < 0.1
    facts = device.facts()
    assert (facts["servos"], facts["baud"]) == ("feetech", 1_000_000)
    assert facts["library"].startswith("feetech-servo-sdk 1")


def test_a_leader_of_feetech_that_is_opened_anew_is_on_the_same_turn(bench: Bench) -> None:
    held = [2.5, -2.5, 2.5, -2.5, 2.5, 0.5]
    fake = bench.play({**FEETECH, "left": [0.0] * 6}, {"at_s": 1, "left": held})
    device = bench.open(fake)
    fake.begin()
    bench.until(lambda: bench.joints(device) == near(held))
    device.close()
    assert bench.joints(bench.open(fake)) == near(held)


def test_a_silent_servo_of_feetech_is_named_and_a_torn_out_port_found_again(bench: Bench) -> None:
    steps = [{"at_s": 1, "silent": [4]}, {"at_s": 3, "silent": []}, {"at_s": 4, "plugged": False},
             {"at_s": 5, "plugged": True}]  # fmt: skip
    fake = bench.play({**FEETECH, "left": POSE}, *steps)
    device = bench.open(fake)
    fake.begin()
    assert bench.fault(device) == (
        "leader FAKE-LEFT: servo 4 (joint_4) is silent; see to its cable and to the one before it"
    )
    device.close()
    bench.until(lambda: not fake.leaders[0].servos[3].is_silent)
    device = bench.open(fake)
    assert bench.joints(device) == near(POSE)
    assert "gone" in bench.fault(device)
    device.close()
    with pytest.raises(
        DeviceError, match=r"no leader found: no usb-1a86_USB_Single_Serial.* plug its servo adapter in"
    ):
        bench.open(fake)
    bench.clock.sleep(1.0)
    bench.until(fake.leaders[0].port.path.exists)
    assert bench.joints(bench.open(fake)) == near(POSE)


def test_a_wrong_rate_and_other_servos_of_a_leader_are_named_in_a_line(bench: Bench) -> None:
    fake = bench.play({**FEETECH, "left": POSE})
    with pytest.raises(DeviceError, match="no servo answers at 115200 baud, but they do at 1000000: set baud: 1000000"):
        bench.open(fake, baud=115_200)
    port = (str(fake.leaders[0].port.path),)
    with pytest.raises(DeviceError) as caught:
        bench.open(fake, servos="dynamixel", ports_wanted=port)
    assert str(caught.value) == (
        f"{port[0]}: leader FAKE-LEFT was calibrated with servos STS3215 of feetech, expected those of dynamixel; "
        "set servos: feetech, or calibrate this leader: station devices calibrate gello --servos dynamixel"
    )


def test_a_rate_that_an_adapter_cannot_do_hides_no_other(bench: Bench) -> None:
    fake = bench.play({**FEETECH, "left": POSE})
    leader = fake.leaders[0]
    leader.port.close()
    leader.port = bench.port(fake.folder, leader.serial, Chain(leader.servos), baud=termios.B57600)
    line = importlib.import_module("serial").Serial

    def only_usual_ones(port: str, baudrate: int, **how: Any) -> Any:
        if baudrate in (250_000, 128_000):
            raise ValueError(f"Failed to set custom baud rate ({baudrate})")
        return line(port, baudrate, **how)

    with pytest.MonkeyPatch.context() as patch:  # within the lines in memory, which are a patch too
        patch.setattr("serial.Serial", only_usual_ones)
        with pytest.raises(
            DeviceError, match="no servo answers at 1000000 baud, but they do at 57600: set baud: 57600"
        ):
            bench.open(fake)
        with pytest.raises(DeviceError, match="its adapter cannot do 250000 baud"):
            bench.open(fake, baud=250_000)


def test_numbers_of_ports_are_checked(bench: Bench, tmp_path: Path) -> None:
    fake = bench.play({"at_s": 0, "left": POSE, "right": POSE})
    with pytest.raises(DeviceError, match=r"2 adapters found, 1 wanted: .*FAKE-LEFT.*FAKE-RIGHT.*choose with ports:"):
        bench.open(fake, leaders=1)
    with pytest.raises(DeviceError, match="1 ports for 2 leaders"):
        bench.open(fake, ports_wanted=("/dev/ttyUSB0",))
    with pytest.raises(DeviceError, match=r"no leader found: no usb-FTDI.* plug its U2D2 in, or name another port"):
        ports.choose((), 1, tmp_path / "none")


@pytest.mark.parametrize("servos", ["dynamixel", "feetech"])
@pytest.mark.parametrize("seed", some(range(12)))
def test_whatever_goes_wrong_a_sample_shows_what_was_the_case_and_nothing_follows_a_fault(
    tmp_path: Path, seed: int, servos: str
) -> None:
    chance = random.Random(seed)
    faults: list[dict[str, Any]] = [
        {"silent": [chance.randint(1, 8)]}, {"silent": []}, {"broken": chance.randint(1, 4)}, {"plugged": False},
        {"plugged": True}, {"arm": "left", "silent": [chance.randint(1, 8)]},
    ]  # fmt: skip
    poses = [[chance.uniform(-1.5, 1.5) for _ in range(7)] + [chance.random()] for _ in range(4)]
    moves = [{"at_s": at_s, "left": poses[at_s], "right": poses[-1 - at_s]} for at_s in range(4)]
    moves[0]["servos"] = servos
    moves += [chance.choice(faults) | {"at_s": round(chance.uniform(0.1, 3.0), 3)} for _ in range(3)]
    told = f"seed {seed}: {moves}"
    with bench_in(tmp_path, seed) as bench:
        fake = bench.play(*sorted(moves, key=lambda move: move["at_s"]))
        device = bench.open(fake)
        fake.begin()
        began_ns, has_ended = bench.clock.monotonic_ns(), False
        newest_ns = 0
        for _ in range(100):
            bench.clock.sleep(chance.choice((0.002, 0.03, 0.1)))
            try:
                reading = device.read()
            except DeviceError:
                has_ended = True
                continue
            assert not has_ended, told
            if reading is not None:
                assert reading.joints is not None
                assert reading.capture_ns is not None
                assert reading.capture_ns >= newest_ns, told
                if reading.capture_ns > newest_ns:  # else one leader is silent, and the sample no new one
                    assert bench.clock.monotonic_ns() - reading.capture_ns < 0.2e9, told
                newest_ns = reading.capture_ns
                at_s = (reading.capture_ns - began_ns) * 1e-9
                shown = [np.interp(at_s, range(4), column) for column in np.array(poses).T]
                assert reading.joints[:7] == pytest.approx(shown[:7], abs=0.05), told
