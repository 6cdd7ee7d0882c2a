"""HID reports of spacemice: layouts, axes, dead band."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.spacemouse.reports import Deflection, encode_buttons, encode_motion, with_dead_band

TWISTS = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)


def after(*reports: bytes) -> Deflection:
    deflection = Deflection()
    for report in reports:
        assert deflection.update(report)
    return deflection


def test_the_axes_are_forward_left_up() -> None:
    # The device's own axes are x right, y towards the person, z down; values checked against pyspacemouse's "ros".
    shown = after(struct.pack("<B3h", 1, 350, 100, -350), struct.pack("<B3h", 2, 35, 70, 105)).twist()
    assert shown == pytest.approx([-100 / 350, -1.0, 1.0, -0.2, -0.1, -0.3])


def test_one_report_of_thirteen_bytes_says_the_same_as_two_of_seven() -> None:
    one = after(struct.pack("<B6h", 1, 350, 100, -350, 35, 70, 105))
    two = after(struct.pack("<B3h", 1, 350, 100, -350), struct.pack("<B3h", 2, 35, 70, 105))
    assert one.twist().tolist() == two.twist().tolist()


def test_translation_stays_while_only_rotation_is_reported() -> None:
    deflection = after(struct.pack("<B3h", 1, 0, -350, 0), struct.pack("<B3h", 2, 0, 0, -350))
    assert deflection.twist().tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def test_a_strong_hand_is_cut_to_full_deflection() -> None:
    assert after(struct.pack("<B3h", 1, 0, -500, 500)).twist().tolist() == [1.0, 0.0, -1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("report", [b"", b"\x17\x64", b"\x01\x00", b"\x02\x01\x02\x03", b"\x03", b"\x09" * 64])
def test_a_report_that_is_something_else_or_short_changes_nothing(report: bytes) -> None:
    deflection = after(struct.pack("<B3h", 1, 0, -350, 0))
    assert not deflection.update(report)
    assert deflection.twist().tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_a_tap_that_is_over_by_now_is_seen_once() -> None:
    deflection = after(encode_buttons([1, 26]), encode_buttons([]))
    assert deflection.pop_pressed() == 1 << 1 | 1 << 26
    assert deflection.pop_pressed() == 0


def test_a_button_that_is_held_stays_pressed() -> None:
    deflection = after(encode_buttons([0]))
    assert [deflection.pop_pressed() for _ in range(3)] == [1, 1, 1]


@given(twist=TWISTS, in_one=st.booleans())
def test_what_a_device_sends_for_a_twist_is_read_as_that_twist(twist: np.ndarray, in_one: bool) -> None:
    shown = after(*encode_motion(twist, in_one=in_one)).twist()
    np.testing.assert_allclose(shown, twist, atol=0.5 / 350 + 1e-9)


@given(twist=TWISTS, dead_band=st.floats(0.0, 0.5))
def test_a_dead_band_keeps_zero_full_sign_and_order(twist: np.ndarray, dead_band: float) -> None:
    shown = with_dead_band(twist, dead_band)
    assert (shown[np.abs(twist) <= dead_band] == 0.0).all()
    assert (shown * twist >= 0.0).all()
    assert (np.abs(shown) <= np.abs(twist) + 1e-12).all()
    np.testing.assert_allclose(with_dead_band(np.sign(twist), dead_band), np.sign(twist))


def test_a_dead_band_has_no_step_at_its_edge() -> None:
    assert with_dead_band(np.array([0.1 + 1e-9]), 0.1) == pytest.approx(0.0, abs=1e-8)
