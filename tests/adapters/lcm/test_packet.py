"""Datagrams: short messages, fragments in any order, and bounds on what is kept of who sends half of one."""

from __future__ import annotations

import random
import struct

import pytest

from adapters.lcm import packet
from adapters.lcm.packet import Assembler, BadPacket, datagrams

LONG = random.Random(1).randbytes(150_000)


def test_a_short_message_is_one_datagram() -> None:
    (datagram,) = datagrams(7, "arm_action", b"abc")
    assert datagram == b"LC02\x00\x00\x00\x07arm_action\x00abc"
    assert Assembler().push(datagram, "a", 0.0) == ("arm_action", b"abc")
    assert datagrams(1 << 32, "a", b"")[0][4:8] == bytes(4)


def test_fragments_make_a_message_in_whatever_order_they_come() -> None:
    parts = datagrams(1, "map", LONG)
    assert len(parts) > 2
    assert all(len(part) < 65_000 for part in parts)
    random.Random(2).shuffle(parts)
    assembler = Assembler()
    found = [assembler.push(part, "a", 0.0) for part in parts]
    assert found[:-1] == [None] * (len(parts) - 1)
    assert found[-1] == ("map", LONG)


def test_messages_of_two_senders_with_one_number_are_not_mixed() -> None:
    assembler, other = Assembler(), LONG[::-1]
    pairs = zip(datagrams(1, "a", LONG), datagrams(1, "b", other), strict=True)
    found = [(assembler.push(one, "x", 0.0), assembler.push(two, "y", 0.0)) for one, two in pairs]
    assert found[-1] == (("a", LONG), ("b", other))


def test_a_message_that_lost_a_fragment_is_forgotten_with_the_next_or_in_time() -> None:
    assembler, first, second = Assembler(), datagrams(1, "a", LONG), datagrams(2, "a", LONG)
    assembler.push(first[0], "x", 0.0)
    assert [assembler.push(part, "x", 0.1) for part in second][-1] == ("a", LONG)
    assembler.push(first[0], "x", 0.0)
    late_s = packet.FORGET_S + 0.1
    assert [assembler.push(part, "x", late_s) for part in first[1:]] == [None, None], "its first fragment is forgotten"


def test_what_is_kept_of_halves_of_messages_is_bounded() -> None:
    assembler, part = Assembler(), datagrams(1, "a", LONG)[0]
    for sender in range(packet.MOST_SENDERS):
        assembler.push(part, sender, 0.0)
    with pytest.raises(BadPacket, match="more than 8 senders"):
        assembler.push(part, "one more", 0.5)
    assert assembler.push(part, "one more", packet.FORGET_S + 0.1) is None


def fragment(*, size: int = 10, offset: int = 0, index: int = 0, count: int = 2, data: bytes = b"a\0hello") -> bytes:
    return struct.pack(">IIIIHH", packet.FRAGMENT, 1, size, offset, index, count) + data


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ([b""], "0 bytes"),
        ([b"LC02\0\0\0\1"], "8 bytes"),
        ([b"LC02\0\0\0\1no end"], "a channel's name"),
        ([b"LC02\0\0\0\1\0message"], "a channel's name"),
        ([b"LC02\0\0\0\1" + b"n" * 64 + b"\0"], "a channel's name"),
        ([b"LC02\0\0\0\1\xff\0"], "a channel's name"),
        ([b"LC04\0\0\0\1a\0message"], "begin with b'LC04'"),
        ([fragment(size=packet.MOST_BYTES + 1)], "fragment 0 of 2"),
        ([fragment(size=0)], "fragment 0 of 2"),
        ([fragment(count=0)], "fragment 0 of 0"),
        ([fragment(count=1000)], "fragment 0 of 1000"),
        ([fragment(index=2)], "fragment 2 of 2"),
        ([fragment(size=3)], "more than the 3 bytes"),
        ([fragment(), fragment(index=1, offset=6, data=b"world")], "a fragment at 6, expected at 5"),
        ([fragment(), fragment(index=1, offset=5, data=b"you")], "fragments of 8 bytes, expected 10"),
    ],
)
def test_what_is_no_datagram_of_lcm_is_refused(parts: list[bytes], told: str) -> None:
    assembler, (*before, last) = Assembler(), parts
    assert [assembler.push(part, "x", 0.0) for part in before] == [None] * len(before)
    with pytest.raises(BadPacket, match=told):
        assembler.push(last, "x", 0.0)


@pytest.mark.parametrize(("channel", "message"), [("", b""), ("n" * 64, b""), ("a", bytes(packet.MOST_BYTES + 1))])
def test_what_no_member_would_take_is_not_sent(channel: str, message: bytes) -> None:
    with pytest.raises(ValueError, match="expected"):
        datagrams(1, channel, message)
