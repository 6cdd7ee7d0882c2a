"""Gloves in virtual time: values, one sample per line, and every way in which lines end."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove.calibration import Calibration, SensorCalibration, Side
from adapters.devices.glove.device import BOOT_S, Glove
from adapters.devices.glove.sensors import FINGERS
from station.operator.device import Device, DeviceError
from station.operator.sample import OperatorSample
from tests.adapters.devices.glove.serial_line import Line, lines_in_memory
from tests.examples import some
from tests.virtual.clock import VirtualClock

OPEN, CLOSED = b"100 3000 100 3000 100\r\n", b"1100 1000 1100 1000 1100\r\n"


def calibration(serial: str = "GL1", side: Side = "left", protocol: str = "numbers") -> Calibration:
    ends = ((100.0, 1100.0), (3000.0, 1000.0))
    sensors = tuple(
        SensorCalibration(name=name, number=number, open=ends[number % 2][0], closed=ends[number % 2][1])
        for number, name in enumerate(FINGERS)
    )
    return Calibration(serial=serial, side=side, date="2026-11-21", protocol=protocol, numbers=5, sensors=sensors)


class Bench:
    """A table with gloves, in virtual time."""

    def __init__(self, clock: VirtualClock, lines: dict[str, Line], folder: Path) -> None:
        self.clock, self.by_id, self.kept = clock, folder / "by-id", folder / "kept"
        self._lines, self._devices = lines, list[Glove]()
        self.by_id.mkdir()

    def plug(self, serial: str = "GL1", side: Side | None = "left", **how: Any) -> Line:
        """Plug a glove in, calibrated where a side is named."""
        line = Line(self.clock, self.by_id, serial)
        self._lines[str(line.path)] = line
        if side is not None:
            calibrations.save(self.kept, calibration(serial, side, **how))
        return line

    def open(self, **options: Any) -> Glove:
        known: dict[str, Any] = {"side": "left", "calibrations_folder": self.kept, "by_id": self.by_id}
        self._devices.append(Glove(**known | {"clock": self.clock, "patience_s": 0.25} | options))
        self.clock.sleep(0.01)  # its thread begins
        return self._devices[-1]

    def fault(self, device: Glove, within_s: float = 10.0) -> str:
        """Return how the device ends."""
        end_s = self.clock.monotonic_s() + within_s
        while self.clock.monotonic_s() < end_s:
            try:
                device.read()
            except DeviceError as error:
                return str(error)
            self.clock.sleep(0.005)
        raise AssertionError("no fault")

    def close(self) -> None:
        for device in self._devices:
            device.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with VirtualClock(1, late_ns=1_000_000) as clock, lines_in_memory() as lines:
        made = Bench(clock, lines, tmp_path)
        try:
            yield made
        finally:
            made.close()


def sent(bench: Bench, line: Line, device: Glove, data: bytes) -> OperatorSample | None:
    """Return what the device gives once it has read some bytes."""
    line.send(data)
    bench.clock.sleep(0.03)
    return device.read()


def shown(sample: OperatorSample) -> list[float]:
    assert sample.joints is not None
    return [float(value) for value in sample.joints]


def test_a_glove_shows_how_far_each_finger_is_closed(bench: Bench) -> None:
    line = bench.plug()
    device = bench.open()
    assert isinstance(device, Device)
    assert device.read() is None
    for data, closed in (
        (b"\n" + OPEN, [0.0] * 5),
        (CLOSED, [1.0] * 5),
        (b"350,2000,0,500,1200\n", [0.25, 0.5, 0, 1, 1]),
    ):
        begun_ns = bench.clock.monotonic_ns()
        sample = sent(bench, line, device, data)
        assert sample is not None
        assert shown(sample) == pytest.approx(closed)
        assert begun_ns <= sample.capture_ns <= bench.clock.monotonic_ns()
        assert device.read() is None, "it was given"
    facts = device.facts()
    assert facts["joints"] == list(FINGERS)
    assert (facts["side"], facts["serial"], facts["protocol"]) == ("left", "GL1", "numbers")
    assert facts["calibration"] == str(bench.kept / "GL1-left.yaml")
    assert facts["library"].startswith("pyserial 3.")


def test_the_letters_of_an_openglove_are_its_fingers(bench: Bench) -> None:
    line = bench.plug(protocol="opengloves")
    device = bench.open(protocol="opengloves")
    sample = sent(bench, line, device, b"\nA100B3000C600D2000E1100F2047G2047P0J\n")
    assert sample is not None
    assert shown(sample) == [0.0, 0.0, 0.5, 0.5, 1.0]


def test_a_sample_is_as_old_as_the_end_of_its_line(bench: Bench) -> None:
    line = bench.plug()
    device = bench.open(patience_s=5.0)
    assert sent(bench, line, device, b"\n100 3000 100 30") is None
    bench.clock.sleep(1.0)
    ended_ns = bench.clock.monotonic_ns()
    sample = sent(bench, line, device, b"00 100\n1100 1000")
    assert sample is not None
    assert 0 <= sample.capture_ns - ended_ns < 10e6
    assert shown(sample) == [0.0] * 5


def test_what_has_queued_up_is_drained_to_the_newest_line(bench: Bench) -> None:
    line = bench.plug()
    device = bench.open()
    sample = sent(bench, line, device, b"\n" + OPEN * 300 + CLOSED)
    assert sample is not None
    assert shown(sample) == [1.0] * 5
    assert device.read() is None


def test_lines_that_are_spoilt_are_passed_over(bench: Bench) -> None:
    line = bench.plug()
    device = bench.open()
    assert sent(bench, line, device, b"\n" + OPEN) is not None
    for bad in (
        b"nan nan nan nan nan\n",
        b"1 2 3\n",
        b"\xff" * 3000 + b"\n",
        b"100 3000 100 3000 100 100 3000\n",
        b"\x00\n",
    ):
        assert sent(bench, line, device, bad) is None
    sample = sent(bench, line, device, CLOSED)
    assert sample is not None
    assert shown(sample) == [1.0] * 5


def test_a_glove_that_falls_silent_is_a_fault_and_nothing_follows(bench: Bench) -> None:
    line = bench.plug()
    device = bench.open(patience_s=0.25)
    assert sent(bench, line, device, b"\n" + OPEN) is not None
    silent_s = bench.clock.monotonic_s()
    assert bench.fault(device) == "nothing comes from the left glove GL1; see to its power and cable (for 0.25 s)"
    assert 0.2 < bench.clock.monotonic_s() - silent_s < 0.35
    line.send(CLOSED)
    bench.clock.sleep(0.1)
    for _ in range(3):
        with pytest.raises(DeviceError):
            device.read()
    assert "GL1" in device.why_silent()


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (
            b"1 2 3\n",
            "no good line comes from the left glove GL1; the last bad one is '1 2 3', expected 5 numbers with",
        ),
        (b"\x1b[31m" + b"x" * 90 + b"\n", rf"is '\x1b[31m{'x' * 51}…', expected 5 numbers"),
        (b"A1B2C3D4E5\n", "the last bad one is 'A1B2C3D4E5', expected 5 numbers"),
        (b"12", "no whole line comes from the left glove GL1; expected 5 numbers with spaces or commas between, and"),
    ],
)
def test_what_came_in_place_of_a_good_line_is_told(bench: Bench, data: bytes, told: str) -> None:
    line = bench.plug()
    device = bench.open()
    assert sent(bench, line, device, b"\n" + OPEN) is not None
    line.send(data)
    assert told in bench.fault(device)


def test_a_microcontroller_that_starts_anew_has_the_time_to(bench: Bench) -> None:
    line = bench.plug()
    device = bench.open(patience_s=0.1)
    line.send(b"ets Jun  8 2016\r\nboot\r\n")
    bench.clock.sleep(BOOT_S - 0.5)
    assert "the last bad one is 'boot'" in device.why_silent()
    assert sent(bench, line, device, OPEN) is not None
    silent = bench.plug("GL2", "right")
    assert silent.users == 0
    opened_s = bench.clock.monotonic_s()
    assert "nothing comes from the right glove GL2" in bench.fault(bench.open(side="right"))
    assert BOOT_S - 0.1 < bench.clock.monotonic_s() - opened_s < BOOT_S + 0.1


def test_what_was_written_before_the_port_was_opened_is_dropped(bench: Bench) -> None:
    line = bench.plug()
    line.waiting = b"\n" + CLOSED
    device = bench.open()
    bench.clock.sleep(0.05)
    assert device.read() is None


def test_a_port_that_is_torn_out_is_gone_and_found_again(bench: Bench) -> None:
    line = bench.plug()
    device = bench.open()
    assert sent(bench, line, device, b"\n" + OPEN) is not None
    line.unplug()
    assert bench.fault(device, 0.1) == f"{line.path}: gone (Input/output error); plug the glove in again"
    device.close()
    with pytest.raises(DeviceError, match="no such port; plug the glove in, or name another with port:"):
        bench.open()
    line.is_plugged = True
    assert sent(bench, line, bench.open(), b"\n" + OPEN) is not None


def test_a_port_is_read_by_one_only(bench: Bench) -> None:
    bench.plug()
    device = bench.open()
    with pytest.raises(DeviceError, match="in use by another process; stop it first"):
        bench.open()
    device.close()
    device.close()
    bench.open()


def test_a_read_returns_at_once(bench: Bench) -> None:
    bench.plug()
    device = bench.open()
    for _ in range(20):
        began_ns = bench.clock.monotonic_ns()
        device.read()
        assert bench.clock.monotonic_ns() == began_ns
        bench.clock.sleep(0.003)


def test_the_port_is_that_of_the_only_glove_for_the_side(bench: Bench) -> None:
    with pytest.raises(
        DeviceError, match=r"no left glove found: no usb-\* in .*; plug it in, or name its port with port:"
    ):
        bench.open()
    bench.plug("OTHER", None)
    with pytest.raises(DeviceError, match=r"none of .*OTHER-if00 has a calibration in .*calibrate glove --side left"):
        bench.open()
    bench.plug("GL1", "left")
    bench.plug("GL2", "right")
    assert bench.open().facts()["serial"] == "GL1"
    assert bench.open(side="right").facts()["serial"] == "GL2"
    third = bench.plug("GL3", "left")
    with pytest.raises(DeviceError, match=r"2 left gloves found: .*GL1.*GL3.*; choose one with port:"):
        bench.open()
    assert bench.open(port=str(third.path)).facts()["serial"] == "GL3"
    with pytest.raises(DeviceError, match="glove OTHER has no calibration for the left hand"):
        bench.open(port=str(bench.by_id / third.path.name.replace("GL3", "OTHER")))


def test_another_protocol_than_that_of_the_calibration_is_refused(bench: Bench) -> None:
    bench.plug()
    with pytest.raises(DeviceError, match="GL1 was calibrated with protocol: numbers, not opengloves; set that, or"):
        bench.open(protocol="opengloves")


def test_a_missing_library_names_the_extra(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.plug()
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(DeviceError, match=r"pip install 'teleop-station\[glove\]'"):
        bench.open()


@pytest.mark.parametrize("seed", some(range(12)))
def test_whatever_comes_a_sample_shows_a_line_that_was_sent_and_is_new(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    with VirtualClock(seed, late_ns=1_000_000) as clock, lines_in_memory() as lines:
        bench = Bench(clock, lines, tmp_path)
        line = bench.plug()
        device = bench.open(patience_s=0.5)
        closed, newest_ns, has_ended, count = -1, 0, False, 0
        steps: list[Callable[[], None]] = [
            lambda: line.send(b"\xff\x00nan 1\n"), lambda: line.send(b"1 2 3\n"), lambda: line.send(b"\n"),
            lambda: clock.sleep(0.2),
        ]  # fmt: skip
        sent_so_far = set[float]()
        for at in range(100):
            closed = at % 101
            sent_so_far.add(closed / 100.0)
            line.send(f"{100 + 10 * closed} 3000 100 3000 100\n".encode())
            chance.choice(steps)()
            if at == 90 and chance.random() < 0.5:
                line.unplug()
            clock.sleep(chance.choice((0.002, 0.03)))
            try:
                sample = device.read()
            except DeviceError:
                has_ended = True
                continue
            assert not has_ended
            if sample is not None:
                count += 1
                assert round(shown(sample)[0], 9) in sent_so_far
                assert shown(sample)[1:] == [0.0] * 4
                assert sample.capture_ns > newest_ns
                newest_ns = sample.capture_ns
        assert count > 30
        bench.close()
