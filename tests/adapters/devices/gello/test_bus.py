"""The real dynamixel-sdk on a pseudo terminal with fake servos."""

from __future__ import annotations

import math
import os
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.servos import Chain, Servo
from adapters.devices.gello import bus as buses
from adapters.devices.gello.bus import MotorBus, PortGone
from station.operator.device import DeviceError

TICKS = {1: 2048, 2: -1024, 3: 0xFDFFFF, 4: 0, 5: 4095}
"""Half a turn, a quarter back, a position whose bytes are the header of a packet, …"""


@pytest.fixture
def servos() -> list[Servo]:
    return [Servo(id_, lambda ticks=ticks: ticks, model=1190 if id_ == 5 else 1200) for id_, ticks in TICKS.items()]


@pytest.fixture
def port(servos: list[Servo], tmp_path: Path) -> Iterator[FakePort]:
    fake = FakePort(tmp_path, "FT1", Chain(servos))
    yield fake
    fake.close()


@pytest.fixture
def bus(port: FakePort) -> Iterator[MotorBus]:
    opened = MotorBus(str(port.path), 57600)
    yield opened
    opened.close()


def test_positions_are_radians_with_their_sign(bus: MotorBus) -> None:
    shown = bus.positions(list(TICKS))
    assert shown is not None
    assert shown.tolist() == pytest.approx([ticks * math.pi / 2048 for ticks in TICKS.values()])
    assert shown[:2].tolist() == pytest.approx([math.pi, -math.pi / 2])


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
    sync = buses.sdk().GroupSyncWrite(handler, packets, 102, 2)
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


def test_servos_at_another_rate_hear_only_noise(servos: list[Servo], tmp_path: Path) -> None:
    fake = FakePort(tmp_path, "FAST", Chain(servos), baud=termios.B1000000)
    try:
        slow = MotorBus(str(fake.path), 57600)
        assert slow.ping([1]) == {}
        slow.close()
        fast = MotorBus(str(fake.path), 1_000_000)
        assert fast.ping([1]) == {1: 1200}
        fast.close()
    finally:
        fake.close()


def test_a_port_that_is_torn_out_is_gone_for_every_call(bus: MotorBus, port: FakePort) -> None:
    assert bus.positions([1]) is not None
    port.unplug()
    for _ in range(2):
        with pytest.raises(PortGone, match=r"FT1-if00-port0: gone \(.*plug the leader in again"):
            bus.positions([1])
    with pytest.raises(PortGone):
        bus.ping([1])
    bus.close()
    bus.close()


def test_a_port_is_read_by_one_process_only(bus: MotorBus) -> None:
    with pytest.raises(DeviceError, match="in use by another process; stop it first"):
        MotorBus(bus.port, 57600)


@pytest.mark.parametrize(
    ("port", "baud", "told"),
    [
        ("/dev/ttyNONE", 57600, r"/dev/ttyNONE: no such port; plug the leader in"),
        ("/", 57600, r"cannot be opened"),
        ("/dev/null", 57600, r"cannot be opened"),
        ("/dev/null", 57601, r"no such baud rate: 57601; GELLO's servos use 57600, 1000000"),
    ],
)
def test_a_port_that_cannot_be_used_is_one_line(port: str, baud: int, told: str) -> None:
    with pytest.raises(DeviceError, match=told) as caught:
        MotorBus(port, baud)
    assert "\n" not in str(caught.value)


def test_a_port_of_others_names_the_group(port: FakePort) -> None:
    os.chmod(port.path, 0)
    if os.access(port.path, os.R_OK):
        pytest.skip("root may open anything")
    with pytest.raises(DeviceError, match="sudo usermod -aG dialout"):
        MotorBus(str(port.path), 57600)


def test_a_missing_permission_names_the_group() -> None:
    assert "permission denied; join the group" in buses._why_not_open("/dev/ttyUSB0", PermissionError(13, "denied"))


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", None)
    with pytest.raises(DeviceError, match=r"pip install 'teleop-station\[gello\]'"):
        MotorBus("/dev/null", 57600)
