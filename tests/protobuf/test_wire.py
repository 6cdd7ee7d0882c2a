"""What is made and read by hand is what the library makes and reads."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from station.episode.storage.pictures import compressed_image, picture_in
from station.protobuf import foxglove, schema
from station.protobuf.wire import bytes_of, varint

IMAGE = schema.message_class(foxglove.schema(foxglove.COMPRESSED_IMAGE))
NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=300)


@given(jpeg=st.binary(min_size=1, max_size=400), taken_ns=st.integers(0, (1 << 63) - 1), camera=NAMES)
def test_a_picture_made_by_hand_is_byte_for_byte_that_of_the_library(jpeg: bytes, taken_ns: int, camera: str) -> None:
    made = compressed_image(jpeg, taken_ns, camera)
    found = IMAGE.FromString(made)
    assert (found.data, found.format, found.frame_id) == (jpeg, "jpeg", camera)
    assert found.timestamp.seconds * 10**9 + found.timestamp.nanos == taken_ns
    assert (found.SerializeToString() == made) is bool(camera)  # an empty name is written here, and left out there
    assert picture_in(made) == jpeg


def test_an_empty_picture_and_a_large_one_come_back() -> None:
    for jpeg in (b"", bytes(5_000_000)):
        assert IMAGE.FromString(compressed_image(jpeg, 1, "head")).data == jpeg
        assert picture_in(compressed_image(jpeg, 1, "head")) == jpeg


def test_the_fields_may_stand_in_any_order_beside_others() -> None:
    other = b"\x28\x96\x01" + b"\x31" + bytes(8) + b"\x3d" + bytes(4)
    assert bytes_of(b"\x1a\x04jpeg" + other + b"\x12\x03abc" + other, 2) == b"abc"
    assert bytes_of(other, 2) == b""


@given(message=st.binary(max_size=60))
def test_bytes_that_are_no_message_are_refused_and_never_read_beyond(message: bytes) -> None:
    try:
        found = bytes_of(message, 2)
    except ValueError:
        return
    assert found in message


@pytest.mark.parametrize("message", [b"\x12", b"\x12\x05abc", b"\x12\xff\xff\xff\xff\x0f", b"\x13", b"\x80" * 11])
def test_a_torn_message_is_refused(message: bytes) -> None:
    with pytest.raises(ValueError, match=r"beyond its end|no number"):
        bytes_of(message, 2)


@given(number=st.integers(0, (1 << 64) - 1))
@example(number=127)
@example(number=128)
@example(number=(1 << 14))
def test_a_number_takes_seven_bits_a_byte(number: int) -> None:
    written = varint(number)
    assert len(written) == max(1, -(-number.bit_length() // 7))
    assert sum((byte & 127) << 7 * place for place, byte in enumerate(written)) == number
