"""The real feetech-servo-sdk with fake servos: on lines in memory, in virtual time; and on a real pseudo terminal."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.fakes.gello import feetech, protocol
from adapters.devices.fakes.gello.feetech import Wire, packet
from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.protocol import Packet
from adapters.devices.fakes.gello.servos import Chain, FeetechServo, Servo, wrapped
from adapters.devices.gello.bus import RAD_PER_TICK, DynamixelBus, FeetechBus, MotorBus
from adapters.devices.serial_port import PortGone
from station.operator.device import DeviceError
from tests.adapters.devices.gello.serial_line import LinePort
from tests.virtual.clock import VirtualClock
from tests.waiting import wait_until

TICKS = {1: 2048, 2: -1024, 3: 4095, 4: 0, 5: 1, 6: 0x7FFF}
EXPECTED = [ticks * math.pi / 2048 for ticks in TICKS.values()]


@pytest.fixture
def shown() -> dict[int, int]:
    """What each servo shows, for a test to change."""
    return dict(TICKS)


@pytest.fixture
def servos(shown: dict[int, int]) -> list[Servo]:
    return [FeetechServo(id_, lambda id_=id_: shown[id_]) for id_ in TICKS]


@pytest.fixture
def bus(line: Callable[..., LinePort], servos: list[Servo], tmp_path: Path) -> Iterator[MotorBus]:
    port = line(tmp_path, "5A1", Chain(servos))
    opened = FeetechBus(str(port.path), 1_000_000, port.clock)
    yield opened
    opened.close()
    port.close()


@pytest.fixture
def real_bus(port: FakePort) -> Iterator[MotorBus]:
    opened = FeetechBus(str(port.path), 1_000_000)
    yield opened
    opened.close()


def positions(bus: MotorBus, ids: list[int] | None = None) -> list[float]:
    """Return what the servos show, asked again on a machine so busy that an answer comes too late."""
    found: list[list[float]] = []

    def look() -> bool:
        read = bus.positions(list(TICKS) if ids is None else ids)
        found.extend([] if read is None else [read.tolist()])
        return bool(found)

    wait_until(look)
    return found[0]


def test_positions_are_radians_with_their_sign(bus: MotorBus) -> None:
    assert positions(bus) == pytest.approx(EXPECTED, abs=RAD_PER_TICK / 2)
    assert positions(bus, [2, 1]) == pytest.approx([-math.pi / 2, math.pi])


def test_a_pseudo_terminal_gives_the_same_positions_whoever_is_silent_or_torn(
    real_bus: MotorBus, servos: list[Servo]
) -> None:
    assert positions(real_bus) == pytest.approx(EXPECTED)
    servos[3].is_silent = True
    assert real_bus.positions(list(TICKS)) is None
    servos[3].is_silent, servos[2].broken_answers = False, 1
    assert real_bus.positions(list(TICKS)) is None
    assert positions(real_bus) == pytest.approx(EXPECTED)


@pytest.mark.parametrize("step", [-700, -1, 1, 700])
def test_a_joint_goes_on_where_its_servo_begins_anew(bus: MotorBus, shown: dict[int, int], step: int) -> None:
    turned = [2000 + step * count for count in range(abs(12_000 // step))]
    for ticks in turned[:: max(1, 600 // abs(step))]:
        shown[1] = wrapped(ticks)
        assert positions(bus, [1]) == pytest.approx([ticks * RAD_PER_TICK])


def test_a_servo_that_counts_its_turns_itself_is_believed(bus: MotorBus, shown: dict[int, int]) -> None:
    for ticks in range(-9000, 9000, 500):
        shown[1] = ticks
        assert positions(bus, [1]) == pytest.approx([ticks * RAD_PER_TICK])


def test_a_servo_of_dynamixel_is_believed_as_before(line: Callable[..., LinePort], tmp_path: Path) -> None:
    shown = [4095]
    fake = line(tmp_path, "FT1", Chain([Servo(1, lambda: shown[0])]))
    bus = DynamixelBus(str(fake.path), 57600, fake.clock)
    for ticks in (4095, 0, 4095, -4096):
        shown[0] = ticks
        assert positions(bus, [1]) == pytest.approx([ticks * RAD_PER_TICK])
    bus.close()
    fake.close()


def test_servos_are_found_by_ping_and_by_a_scan(bus: MotorBus, servos: list[Servo], clock: VirtualClock) -> None:
    assert bus.ping([1, 6, 9]) == {1: 777, 6: 777}
    assert bus.scan() == dict.fromkeys(TICKS, 777)
    for servo in servos:
        servo.is_silent = True
    began_s = clock.monotonic_s()
    assert bus.scan() == {}
    assert 1.3 < clock.monotonic_s() - began_s < 1.6


def test_the_sdk_writes_and_reads_the_table_of_a_servo(bus: MotorBus) -> None:
    packets, handler = bus._packets, bus._handler
    assert packets.ping(handler, 2) == (777, 0, 0)
    assert packets.write2ByteTxRx(handler, 1, 42, 0x0FFF) == (0, 0)
    assert packets.read2ByteTxRx(handler, 1, 42) == (0x0FFF, 0, 0)
    assert packets.write1ByteTxRx(handler, 1, 40, 1) == (0, 0)
    assert packets.write1ByteTxRx(handler, 1, 33, 3)[0] != 0, "what is kept is not written while the torque is on"
    sync = bus._sdk.GroupSyncWrite(handler, packets, 42, 2)
    for id_ in (1, 2):
        sync.addParam(id_, [id_, 0])
    assert sync.txPacket() == 0
    assert packets.read2ByteTxRx(handler, 2, 42)[0] == 2


def test_a_silent_servo_is_no_position_after_the_librarys_time_by_the_given_clock(
    bus: MotorBus, servos: list[Servo], clock: VirtualClock
) -> None:
    servos[3].is_silent = True
    clock.call_at(clock.monotonic_ns() + 10_000_000, lambda: setattr(clock, "wall_ahead_ns", 3600 * 10**9))
    began_s = clock.monotonic_s()
    assert bus.positions(list(TICKS)) is None
    assert 0.03 < clock.monotonic_s() - began_s < 0.06
    assert 4 not in bus.ping(list(TICKS))
    servos[3].is_silent = False
    assert bus.positions(list(TICKS)) is not None


def test_a_torn_answer_is_no_position_and_the_next_is_right(bus: MotorBus, servos: list[Servo]) -> None:
    servos[2].broken_answers = 1
    assert bus.positions(list(TICKS)) is None
    assert positions(bus) == pytest.approx(EXPECTED)


def test_an_answer_without_a_number_is_no_position(bus: MotorBus, servos: list[Servo]) -> None:
    servos[0].read = lambda address, length: b""  # type: ignore[method-assign]
    assert bus.positions(list(TICKS)) is None
    assert 1 not in bus.ping(list(TICKS))


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next(
    real_bus: MotorBus, port: FakePort, shown: dict[int, int]
) -> None:
    port.delay_s = 0.1
    assert real_bus.positions(list(TICKS)) is None
    wait_until(lambda: real_bus._handler.getBytesAvailable() == 8 * len(TICKS))
    port.delay_s, shown[1] = 0.0, 1024
    assert positions(real_bus)[0] == pytest.approx(math.pi / 2)


def test_a_port_that_is_torn_out_is_gone_for_every_call(real_bus: MotorBus, port: FakePort) -> None:
    positions(real_bus)
    port.unplug()
    for _ in range(2):
        with pytest.raises(PortGone, match=r"FT1-if00: gone \(.*plug the leader in again"):
            real_bus.positions([1])
    with pytest.raises(PortGone):
        real_bus.ping([1])
    with pytest.raises(PortGone):
        real_bus.scan()
    real_bus.close()
    real_bus.close()


def test_a_port_is_read_by_one_process_only(real_bus: MotorBus) -> None:
    with pytest.raises(DeviceError, match="in use by another process; stop it first"):
        FeetechBus(real_bus.port, 1_000_000)


def test_every_rate_can_be_set_on_a_real_port(port: FakePort) -> None:
    for baud in FeetechBus.bauds:
        bus = FeetechBus(str(port.path), baud)
        assert bus.ping([1], attempts=1 if baud != 1_000_000 else 20) == ({1: 777} if baud == 1_000_000 else {})
        bus.close()


@pytest.mark.parametrize(
    ("port", "baud", "told"),
    [
        ("/dev/ttyNONE", 1_000_000, r"/dev/ttyNONE: no such port; plug the leader in"),
        ("/dev/null", 1_000_000, r"cannot be opened"),
        ("/dev/null", 2_000_000, r"no such baud rate: 2000000; GELLO's feetech servos use 1000000, 500000"),
    ],
)
def test_a_port_that_cannot_be_used_is_one_line(port: str, baud: int, told: str) -> None:
    with pytest.raises(DeviceError, match=told) as caught:
        FeetechBus(port, baud)
    assert "\n" not in str(caught.value)


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scservo_sdk", None)
    with pytest.raises(DeviceError, match=r"needs feetech-servo-sdk.*pip install 'teleop-station\[gello\]'"):
        FeetechBus("/dev/null", 1_000_000)


def test_a_ping_is_as_the_library_sends_it() -> None:
    assert packet(1, protocol.PING, b"") == bytes.fromhex("ffff010201fb")
    assert feetech.status(1, 0, bytes([0x18, 0x05])) == bytes.fromhex("ffff0104001805dd")


@given(cut=st.integers(0, 40), noise=st.binary(max_size=6).filter(lambda data: b"\xff" not in data))
def test_packets_are_found_in_pieces_and_between_noise(cut: int, noise: bytes) -> None:
    data = noise + packet(3, protocol.READ, bytes([56, 2])) + noise + packet(4, protocol.WRITE, b"\x2a\xff\xff\x01")
    wire = Wire()
    found = wire.feed(data[:cut]) + wire.feed(data[cut:])
    assert found == [Packet(3, protocol.READ, bytes([56, 0, 2, 0])), Packet(4, protocol.WRITE, b"\x2a\x00\xff\xff\x01")]


def test_a_packet_that_was_torn_is_noise() -> None:
    torn = bytearray(packet(7, protocol.PING, b""))
    torn[-1] ^= 1
    assert Wire().feed(bytes(torn) + packet(8, protocol.PING, b"")) == [Packet(8, protocol.PING, b"")]
    assert Wire().feed(b"\xff" + packet(8, protocol.PING, b"")) == [Packet(8, protocol.PING, b"")]
