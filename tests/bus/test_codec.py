"""Values as bytes: TWIST's JSON to the byte, ours to the bit."""

from __future__ import annotations

import json
import math
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.bus import codec

finite = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(finite))
def test_a_vector_is_written_byte_for_byte_as_python_writes_it(values: list[float]) -> None:
    assert codec.json_vector(values) == json.dumps(values).encode()
    assert codec.json_vector(np.array(values)) == json.dumps(values).encode()


@given(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False)))
def test_float32_widened_by_stock_scripts_is_written_alike(values: list[float]) -> None:
    widened = np.array(values, dtype=np.float32).tolist()
    assert codec.json_vector(widened) == json.dumps(widened).encode()


def test_nan_and_infinity_are_written_as_stock_scripts_write_them() -> None:
    values = [math.nan, math.inf, -math.inf, 1.0]
    assert codec.json_vector(values) == b"[NaN, Infinity, -Infinity, 1.0]"


@given(st.lists(finite))
def test_a_vector_comes_back_bit_for_bit(values: list[float]) -> None:
    back = codec.parse_json_vector(codec.json_vector(values), len(values))
    assert back.tobytes() == np.array(values, dtype=np.float64).tobytes()


def test_whole_numbers_and_other_white_space_are_accepted() -> None:
    assert codec.parse_json_vector(b"[1,2 , 3]\n").tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not JSON"),
        (b"[1, 2", "not JSON"),
        (b"hello", "not JSON: 'hello'"),
        (b"\xff\xfe", "not JSON"),
        (b"{}", "a JSON dict, expected a list"),
        (b"null", "a JSON NoneType, expected a list"),
        (b"[1, NaN, 2]", "element 1 is nan, expected a finite number"),
        (b"[Infinity]", "element 0 is inf"),
        (b'[1, "2"]', "element 1 is '\"2\"', expected a number"),
        (b"[[1], [2]]", "element 0 is '[1]'"),
        (b"[true]", "element 0 is 'true'"),
        (b"[1e999]", "element 0 is inf"),
        (b"[1, 2, 3]", "3 values, expected 35"),
        (b"[" + b"1, " * 35 + b"1]", "36 values, expected 35"),
        (b"[" * 100_000, "not JSON"),
    ],
)
def test_anything_else_is_refused_with_what_came(data: bytes, reason: str) -> None:
    with pytest.raises(codec.BadValue) as caught:
        codec.parse_json_vector(data, 35)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [b'"\xff"', b"", b"{", b"[1, 2]", b'{"a": ' + b"[" * 100_000, b'{"a": "b"}'])
def test_whatever_is_no_struct_is_a_bad_value(data: bytes) -> None:
    with pytest.raises(codec.BadValue):
        codec.parse_struct(data, dict[str, int])


HUGE = b"1" + b"0" * 400
DEEP = b"[" * 100 + b"]" * 100


class Told(msgspec.Struct):
    count: int = 0
    rate: float = 0.0
    detail: dict[str, Any] = {}


@pytest.mark.parametrize("number", [HUGE, b"-" + HUGE, b"9223372036854775808", b"-9223372036854775809", b"9" * 5000])
@pytest.mark.parametrize("text", [b'{"count": %b}', b'{"rate": %b}', b'{"detail": {"a": [%b]}}', b'{"unknown": %b}'])
def test_an_integer_of_more_than_64_bits_is_refused_wherever_it_stands(text: bytes, number: bytes) -> None:
    data = text.replace(b"%b", number)
    with pytest.raises(codec.BadValue):
        codec.parse_struct(data, Told)
    with pytest.raises(codec.BadValue):
        codec.parse_json(data)
    assert codec.parse_facts(data) == {}


def test_the_largest_and_the_smallest_integer_of_64_bits_are_read_exactly() -> None:
    data = b'{"count": 9223372036854775807, "detail": {"a": -9223372036854775808}}'
    read = codec.parse_struct(data, Told)
    assert (read.count, read.detail["a"]) == (2**63 - 1, -(2**63))
    assert codec.parse_json(data) == {"count": 2**63 - 1, "detail": {"a": -(2**63)}}


def test_a_vector_of_huge_integers_is_refused_with_the_number_of_digits() -> None:
    with pytest.raises(codec.BadNumber, match="an integer of 401 digits, expected at most 64 bits"):
        codec.parse_json_vector(b"[" + b", ".join([HUGE] * 35) + b"]", 35)


@pytest.mark.parametrize("data", [b'{"detail": {"a": ' + DEEP + b"}}", b'{"a":' * 65 + b"1" + b"}" * 65])
def test_what_nests_deeper_than_can_be_written_again_everywhere_is_refused(data: bytes) -> None:
    with pytest.raises(codec.BadValue, match="nest deeper than 64"):
        codec.parse_json(data)
    with pytest.raises(codec.BadValue, match="nest deeper than 64"):
        codec.parse_struct(data, Told)


def test_many_lists_beside_each_other_are_not_deep() -> None:
    data = b'{"detail": {"a": [' + b", ".join([b"[1]"] * 200) + b"]}}"
    assert codec.parse_struct(data, Told).detail == codec.parse_json(data)["detail"] == {"a": [[1]] * 200}


def test_json_of_more_than_a_megabyte_is_refused() -> None:
    data = b'{"detail": {"a": "' + b"x" * codec.MAX_BYTES + b'"}}'
    for parse in (codec.parse_json, codec.parse_json_vector, lambda data: codec.parse_struct(data, Told)):
        with pytest.raises(codec.BadValue, match="bytes of JSON, expected at most 1048576"):
            parse(data)


@pytest.mark.parametrize("data", [b'{"a": "\xed\xa0\x80"}', b'{"a": "\\ud800"}', '{"a": 1}'.encode("utf-16")])
def test_text_that_is_not_utf_8_is_refused_however_it_is_spelled(data: bytes) -> None:
    with pytest.raises(codec.BadValue, match="not JSON"):
        codec.parse_json(data)


def test_numbers_are_finite_and_no_booleans() -> None:
    found = [codec.number(value) for value in (1, 2.5, -0.0, True, "1", None, math.inf, math.nan, 10**400, -(10**400))]
    assert found == [1.0, 2.5, 0.0, *[None] * 7]


def test_a_struct_comes_back() -> None:
    assert codec.parse_struct(codec.json_object({"a": 1}), dict[str, int]) == {"a": 1}


def test_raw_vectors_come_back_and_torn_ones_are_refused() -> None:
    values = np.random.default_rng(0).normal(size=35)
    assert codec.parse_f64(codec.f64(values)).tobytes() == values.tobytes()
    assert codec.parse_f32(codec.f32(values)).tobytes() == values.astype(np.float32).tobytes()
    with pytest.raises(codec.BadValue, match="9 bytes, expected a multiple of 8"):
        codec.parse_f64(b"123456789")


@pytest.fixture
def busy_threads() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_threads_that_meet_a_type_for_the_first_time_all_decode_it(busy_threads: None) -> None:
    for number in range(50):
        fields = [
            (f"field{n}", Annotated[dict[str, int], msgspec.Meta(max_length=n + 9)] | None, None) for n in range(20)
        ]
        kind = msgspec.defstruct(f"Met{number}", fields, namespace={})
        together = threading.Barrier(4)

        def decode(kind: type[msgspec.Struct] = kind, together: threading.Barrier = together) -> msgspec.Struct:
            together.wait()
            return codec.parse_struct(b'{"field7": {"a": 1}}', kind)

        with ThreadPoolExecutor(4) as threads:
            found = [future.result() for future in [threads.submit(decode) for _ in range(4)]]
        assert [value.field7 for value in found] == [{"a": 1}] * 4  # type: ignore[attr-defined]
