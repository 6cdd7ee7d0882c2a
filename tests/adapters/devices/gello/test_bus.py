"""The real dynamixel-sdk with fake servos: on lines in memory, in virtual time; and on a real pseudo terminal."""

from __future__ import annotations

import math
import os
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.servos import Chain, Servo
from adapters.devices.gello.bus import DynamixelBus, MotorBus
from adapters.devices.serial_port import PortGone, why_not_open
from station.operator.device import DeviceError
from tests.adapters.devices.gello.serial_line import LinePort
from tests.virtual.clock import VirtualClock
from tests.waiting import wait_until

TICKS = {1: 2048, 2: -1024, 3: 0xFDFFFF, 4: 0, 5: 4095}
"""Half a turn, a quarter back, a position whose bytes are the header of a packet, …"""


@pytest.fixture
def servos() -> list[Servo]:
    return [Servo(id_, lambda ticks=ticks: ticks, model=1190 if id_ == 5 else 1200) for id_, ticks in TICKS.items()]


@pytest.fixture
def bus(line: Callable[..., LinePort], servos: list[Servo], tmp_path: Path) -> Iterator[MotorBus]:
    port = line(tmp_path, "FT1", Chain(servos))
    opened = DynamixelBus(str(port.path), 57600, port.clock)
    yield opened
    opened.close()
    port.close()


@pytest.fixture
def real_bus(port: FakePort) -> Iterator[MotorBus]:
    opened = DynamixelBus(str(port.path), 57600)
    yield opened
    opened.close()


def test_positions_are_radians_with_their_sign(bus: MotorBus) -> None:
    shown = bus.positions(list(TICKS))
    assert shown is not None
    assert shown.tolist() == pytest.approx([ticks * math.pi / 2048 for ticks in TICKS.values()])
    assert shown[:2].tolist() == pytest.approx([math.pi, -math.pi / 2])


def test_a_pseudo_terminal_gives_the_same_positions_whoever_is_silent_or_torn(
    real_bus: MotorBus, servos: list[Servo]
) -> None:
    expected = pytest.approx([ticks * math.pi / 2048 for ticks in TICKS.values()])
    assert _shown(real_bus) == expected
    servos[3].is_silent = True
    assert real_bus.positions(list(TICKS)) is None
    servos[3].is_silent, servos[2].broken_answers = False, 1
    assert real_bus.positions(list(TICKS)) is None
    assert _shown(real_bus) == expected


def _shown(bus: MotorBus) -> list[float]:
    found: list[float] = []

    def look() -> bool:
        shown = bus.positions(list(TICKS))
        found[:] = [] if shown is None else shown.tolist()
        return bool(found)

    wait_until(look)  # on a busy machine an answer may come later than the library waits
    return found


def test_a_subset_can_be_read_after_all(bus: MotorBus) -> None:
    assert bus.positions(list(TICKS)) is not None
    some = bus.positions([5, 1])
    assert some is not None
    assert some.tolist() == pytest.approx([4095 * math.pi / 2048, math.pi])


def test_servos_are_found_by_ping_and_by_a_scan(bus: MotorBus) -> None:
    models = {1: 1200, 2: 1200, 3: 1200, 4: 1200, 5: 1190}
    assert bus.ping([1, 5, 9]) == {1: 1200, 5: 1190}
    assert bus.scan() == models


def test_the_sdk_writes_and_reads_the_table_of_a_servo(bus: MotorBus) -> None:
    packets, handler = bus._packets, bus._handler
    assert packets.write4ByteTxRx(handler, 1, 116, 0xFDFFFF)[0] == 0
    assert packets.read4ByteTxRx(handler, 1, 116)[:2] == (0xFDFFFF, 0)
    assert packets.write1ByteTxRx(handler, 1, 64, 1) == (0, 0)
    assert packets.write1ByteTxRx(handler, 1, 11, 4) == (0, 7), "no access to what is kept while the torque is on"
    assert packets.readTxRx(handler, 1, 254, 4)[2] == 5, "beyond the table"
    sync = bus._sdk.GroupSyncWrite(handler, packets, 102, 2)
    for id_ in (1, 2):
        sync.addParam(id_, [id_, 0])
    assert sync.txPacket() == 0
    assert packets.read2ByteTxRx(handler, 2, 102)[0] == 2


def test_a_silent_servo_is_no_position_and_the_bus_recovers(bus: MotorBus, servos: list[Servo]) -> None:
    servos[3].is_silent = True
    assert bus.positions(list(TICKS)) is None
    assert 4 not in bus.ping(list(TICKS))
    servos[3].is_silent = False
    assert bus.positions(list(TICKS)) is not None


def test_a_torn_answer_is_no_position_and_the_next_is_right(bus: MotorBus, servos: list[Servo]) -> None:
    servos[2].broken_answers = 1
    assert bus.positions(list(TICKS)) is None
    assert bus.positions(list(TICKS)) is not None


def test_an_answer_that_came_late_and_has_no_number_is_no_position(
    bus: MotorBus, servos: list[Servo], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as late:
        late.setattr(servos[2], "read", lambda address, length: b"")  # as of a write
        assert bus.positions(list(TICKS)) is None
    assert bus.positions(list(TICKS)) is not None


@pytest.mark.parametrize("set_s", [-3600.0, 3600.0])
def test_a_wall_clock_that_is_set_spoils_no_reading(
    bus: MotorBus, servos: list[Servo], clock: VirtualClock, set_s: float
) -> None:
    servos[3].is_silent = True
    at_ns = clock.monotonic_ns() + 10_000_000  # while the library waits
    clock.call_at(at_ns, lambda: setattr(clock, "wall_ahead_ns", round(set_s * 1e9)))
    began_s = clock.monotonic_s()
    assert bus.positions(list(TICKS)) is None
    assert 0.03 < clock.monotonic_s() - began_s < 0.06, "the library's own time-out, whatever the wall clock does"
    servos[3].is_silent = False
    assert bus.positions(list(TICKS)) is not None


def test_servos_at_another_rate_hear_only_noise(
    line: Callable[..., LinePort], servos: list[Servo], tmp_path: Path
) -> None:
    fake = line(tmp_path, "FAST", Chain(servos), baud=termios.B1000000)
    try:
        slow = DynamixelBus(str(fake.path), 57600, fake.clock)
        assert slow.ping([1]) == {}
        slow.close()
        fast = DynamixelBus(str(fake.path), 1_000_000, fake.clock)
        assert fast.ping([1]) == {1: 1200}
        fast.close()
    finally:
        fake.close()


def test_a_port_that_is_torn_out_is_gone_for_every_call(real_bus: MotorBus, port: FakePort) -> None:
    bus = real_bus
    assert _shown(bus)
    port.unplug()
    for _ in range(2):
        with pytest.raises(PortGone, match=r"FT1-if00-port0: gone \(.*plug the leader in again"):
            bus.positions([1])
    with pytest.raises(PortGone):
        bus.ping([1])
    bus.close()
    bus.close()


def test_a_port_is_read_by_one_process_only(real_bus: MotorBus) -> None:
    with pytest.raises(DeviceError, match="in use by another process; stop it first"):
        DynamixelBus(real_bus.port, 57600)


@pytest.mark.parametrize(
    ("port", "baud", "told"),
    [
        ("/dev/ttyNONE", 57600, r"/dev/ttyNONE: no such port; plug the leader in"),
        ("/", 57600, r"cannot be opened"),
        ("/dev/null", 57600, r"cannot be opened"),
        ("/dev/null", 57601, r"no such baud rate: 57601; GELLO's dynamixel servos use 57600, 1000000"),
    ],
)
def test_a_port_that_cannot_be_used_is_one_line(port: str, baud: int, told: str) -> None:
    with pytest.raises(DeviceError, match=told) as caught:
        DynamixelBus(port, baud)
    assert "\n" not in str(caught.value)


def test_a_port_of_others_names_the_group(port: FakePort) -> None:
    os.chmod(port.path, 0)
    if os.access(port.path, os.R_OK):
        pytest.skip("root may open anything")
    with pytest.raises(DeviceError, match="sudo usermod -aG dialout"):
        DynamixelBus(str(port.path), 57600)


def test_a_missing_permission_names_the_group() -> None:
    told = why_not_open("/dev/ttyUSB0", PermissionError(13, "denied"), device="leader", setting="ports")
    assert "permission denied; join the group" in told


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", None)
    with pytest.raises(DeviceError, match=r"pip install 'teleop-station\[gello\]'"):
        DynamixelBus("/dev/null", 57600)
