"""The fake servos' side of protocol 2.0."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.fakes.gello import protocol
from adapters.devices.fakes.gello.protocol import Packet, Wire, crc16, packet, status

HEADER = b"\xff\xff\xfd"


def test_the_crc_is_that_of_the_makers_example() -> None:
    # A ping of servo 1 as it stands in the maker's manual: FF FF FD 00 01 03 00 01 19 4E.
    assert packet(1, protocol.PING, b"") == bytes.fromhex("fffffd000103000119 4e")
    assert crc16(bytes.fromhex("fffffd0001030001")) == 0x4E19


@given(data=st.binary(max_size=40), id_=st.integers(0, 253))
def test_a_packet_is_read_back_whatever_it_holds(data: bytes, id_: int) -> None:
    sent = packet(id_, protocol.WRITE, data)
    assert sent[3:].find(HEADER) < 0 or sent[3:].find(HEADER + b"\xfd") >= 0
    assert Wire().feed(sent) == [Packet(id_, protocol.WRITE, data)]


@given(cut=st.integers(0, 60), noise=st.binary(max_size=6).filter(lambda data: b"\xff" not in data))
def test_packets_are_found_in_pieces_and_between_noise(cut: int, noise: bytes) -> None:
    data = noise + packet(3, protocol.READ, HEADER * 3) + noise + packet(4, protocol.PING, b"")
    wire = Wire()
    found = wire.feed(data[:cut]) + wire.feed(data[cut:])
    assert found == [Packet(3, protocol.READ, HEADER * 3), Packet(4, protocol.PING, b"")]


def test_a_packet_that_was_torn_has_no_instruction() -> None:
    sent = bytearray(packet(7, protocol.PING, b""))
    sent[-1] ^= 1
    assert Wire().feed(bytes(sent)) == [Packet(7, None, b"")]


def test_a_length_that_cannot_be_is_skipped() -> None:
    assert Wire().feed(HEADER + b"\x00\x01\xff\xff\x01" + packet(2, protocol.PING, b"")) == [
        Packet(2, protocol.PING, b"")
    ]


def test_a_status_that_holds_a_header_is_stuffed() -> None:
    assert status(1, 0, HEADER).count(HEADER + b"\xfd") == 1
