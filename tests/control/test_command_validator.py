"""What is a good command, and what is said of the others."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station import registry
from station.control.command_validator import Checked, CommandSample, CommandValidator, Refusal, check_command

FORMAT = registry.find("command", "twist2")


def _text(**changes: object) -> bytes:
    values = FORMAT.default.tolist()
    for index, value in changes.items():
        values[int(index[1:])] = value
    return json.dumps(values).encode()


def test_the_default_is_a_good_command() -> None:
    checked = check_command(_text(), FORMAT)
    assert isinstance(checked, Checked)
    np.testing.assert_array_equal(checked.vector, FORMAT.default)
    assert checked.clamped == ()


def test_integers_are_numbers_as_stock_writers_send_them() -> None:
    assert isinstance(check_command(_text(_0=1, _1=0), FORMAT), Checked)


def test_an_element_a_little_outside_its_range_is_clamped_and_counted() -> None:
    beyond = FORMAT.upper[9] + FORMAT.margin[9] / 2
    checked = check_command(_text(_9=beyond, _2=FORMAT.lower[2] - FORMAT.margin[2] / 2), FORMAT)
    assert isinstance(checked, Checked)
    assert checked.clamped == (2, 9)
    assert checked.vector[9] == FORMAT.upper[9]
    assert checked.vector[2] == FORMAT.lower[2]


@pytest.mark.parametrize(
    ("data", "kind", "text"),
    [
        (b"", "not-json", "not JSON"),
        (b"hello", "not-json", "not JSON"),
        (b"\xff\xfe\x00", "not-json", "not JSON"),
        (b"null", "not-json", "NoneType"),
        (b'{"a": 1}', "not-json", "dict"),
        (b'["a"]', "not-json", "expected a number"),
        (b"[[1, 2]]", "not-json", "expected a number"),
        (b"[true]", "not-json", "expected a number"),
        (b"[" * 5000, "not-json", "not JSON"),
        (b"[]", "wrong-length", "0 values, expected 35"),
        (json.dumps([0.0] * 37).encode(), "wrong-length", "37 values, expected 35"),
        (json.dumps([0.0] * 5000).encode(), "wrong-length", "bytes, expected a JSON list of 35 numbers"),
        (_text(_7=math.nan), "not-finite", "nan"),
        (_text(_7=-math.inf), "not-finite", "-inf"),
        (_text(_6="X").replace(b'"X"', b"1e999"), "not-finite", "inf"),
        (_text(_6="X").replace(b'"X"', b"1" + b"0" * 400), "not-finite", "an integer of 401 digits"),
        (_text(_6=9.0), "out-of-range", "left_hip_pitch_pos is 9, allowed"),
        (_text(_2=-0.5), "out-of-range", "root_height is -0.5, allowed"),
        (_text(_0=1e300), "out-of-range", "root_vel_x"),
    ],
)
def test_other_values_are_refused_with_kind_and_reason(data: bytes, kind: str, text: str) -> None:
    refusal = check_command(data, FORMAT)
    assert isinstance(refusal, Refusal)
    assert refusal.kind == kind
    assert text in refusal.text
    assert len(refusal.text) < 200


@given(st.one_of(st.binary(), st.text().map(str.encode), st.lists(st.floats()).map(lambda x: json.dumps(x).encode())))
def test_no_bytes_make_the_check_fail(data: bytes) -> None:
    assert isinstance(check_command(data, FORMAT), (Checked, Refusal))


@given(st.lists(st.floats(-20, 20), min_size=35, max_size=35))
def test_whatever_is_let_through_is_within_its_range(values: list[float]) -> None:
    checked = check_command(json.dumps(values).encode(), FORMAT)
    if isinstance(checked, Checked):
        assert (checked.vector >= FORMAT.lower).all()
        assert (checked.vector <= FORMAT.upper).all()


def test_the_validator_keeps_the_newest_good_command_and_counts_each_refused_sample_once() -> None:
    validator = CommandValidator(FORMAT)
    good = CommandSample(_text(), arrived_s=1.0)
    bad = CommandSample(b"[1]", arrived_s=1.1)
    assert validator.update(good)
    assert not validator.update(good)
    assert validator.update(bad)
    assert not validator.update(bad)
    assert validator.good is good
    assert validator.refused == {"wrong-length": 1}
    assert validator.age_s(1.5) == pytest.approx(0.5)
    assert validator.update(CommandSample(_text(), arrived_s=1.6))
    assert validator.refusal is None


def test_a_command_of_unknown_arrival_is_infinitely_old() -> None:
    validator = CommandValidator(FORMAT)
    assert validator.age_s(5.0) == math.inf
    validator.update(CommandSample(_text(), arrived_s=None))
    assert validator.age_s(5.0) == math.inf


def test_a_clock_that_jumps_back_makes_no_command_young_again() -> None:
    validator = CommandValidator(FORMAT)
    validator.update(CommandSample(_text(), arrived_s=10.0))
    assert validator.age_s(10.0) == 0.0
    assert validator.age_s(10.25) == pytest.approx(0.25)
    assert validator.age_s(4.0) == pytest.approx(0.25)
    assert validator.age_s(4.1) == pytest.approx(0.35)
    assert validator.age_s(math.nan) == pytest.approx(0.35)
    assert validator.age_s(10.5) == pytest.approx(6.75), "time that passed here counts, in doubt as too old"


def test_a_command_that_comes_a_moment_after_the_clock_was_read_is_fresh() -> None:
    validator = CommandValidator(FORMAT)
    validator.update(CommandSample(_text(), arrived_s=10.0005))
    assert validator.age_s(10.0) == pytest.approx(-0.0005)


@pytest.mark.parametrize("arrived_s", [math.nan, math.inf, -math.inf])
def test_a_command_whose_arrival_is_no_number_is_infinitely_old(arrived_s: float) -> None:
    validator = CommandValidator(FORMAT)
    validator.update(CommandSample(_text(), arrived_s=arrived_s))
    assert validator.age_s(5.0) == math.inf


def test_refusing_is_what_it_does_now_and_not_what_it_did_once() -> None:
    validator = CommandValidator(FORMAT)
    assert not validator.is_refusing(1.0, within_s=0.3)
    validator.update(CommandSample(b"[1]", arrived_s=1.0))
    assert validator.is_refusing(1.2, within_s=0.3)
    assert not validator.is_refusing(1.4, within_s=0.3)
    validator.update(CommandSample(b"[1]", arrived_s=None))
    assert not validator.is_refusing(1.0, within_s=0.3)


def test_it_is_quiet_for_as_long_as_nothing_came_good_or_bad() -> None:
    validator = CommandValidator(FORMAT)
    assert validator.quiet_s(1.0) == math.inf
    validator.update(CommandSample(_text(), arrived_s=1.0))
    validator.update(CommandSample(b"[1]", arrived_s=1.5))
    assert validator.quiet_s(2.0) == pytest.approx(0.5)


def test_a_command_of_unknown_arrival_that_is_found_later_may_have_come_just_now() -> None:
    validator = CommandValidator(FORMAT)
    validator.update(CommandSample(_text(), arrived_s=1.0))
    validator.update(CommandSample(_text(), arrived_s=None))
    assert validator.quiet_s(math.nan) == 0.0
    assert validator.quiet_s(9.0) == 0.0
    assert validator.quiet_s(9.25) == pytest.approx(0.25)
    validator.update(CommandSample(_text(), arrived_s=None))
    assert validator.quiet_s(9.5) == 0.0
