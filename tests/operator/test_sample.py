"""A sample of a device goes over the bus and comes back as it was; what no device wrote is refused by name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from station.bus import codec, contracts, keys
from station.bus.sample import Sample
from station.operator import sample as readings
from station.operator.sample import Body, OperatorSample, Pose, Status

TURN = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
HAND = np.concatenate([np.arange(78.0).reshape(26, 3), np.tile(TURN, (26, 1))], axis=1)
FULL = OperatorSample(
    capture_ns=123,
    controls={"left_trigger": 0.25, "right_primary": 1.0},
    head=Pose(np.array([1.0, 2.0, 3.0]), TURN),
    left=Pose(np.array([4.0, 5.0, 6.0]), TURN),
    right=Pose(np.array([7.0, 8.0, 9.0]), TURN),
    body=Body(np.arange(72.0).reshape(24, 3), np.tile(TURN, (24, 1))),
    hands={"left": HAND, "right": HAND + 0.0},
    twist=np.linspace(-1.0, 1.0, 6),
    joints=np.arange(7.0),
)


def on_the_bus(values: Mapping[str, bytes]) -> dict[str, Sample]:
    return {key: Sample(key, value, None, 0) for key, value in values.items()}


def written(reading: OperatorSample, **status: Any) -> dict[str, Sample]:
    said = Status(state="live", capture_ns=reading.capture_ns, parts=readings.parts(reading), **status)
    return on_the_bus(readings.encode("pico", reading) | readings.encode_status("pico", said))


def test_a_sample_comes_back_as_it_was_written() -> None:
    got = readings.decode("pico", written(FULL))
    assert got.capture_ns == 123
    assert got.controls == FULL.controls
    for mine, theirs in ((got.head, FULL.head), (got.left, FULL.left), (got.right, FULL.right)):
        assert mine is not None
        assert theirs is not None
        assert np.array_equal(mine.position, theirs.position)
        assert np.array_equal(mine.quat_wxyz, theirs.quat_wxyz)
    assert got.body is not None
    assert FULL.body is not None
    assert np.array_equal(got.body.positions, FULL.body.positions)
    assert np.array_equal(got.body.quats_wxyz, FULL.body.quats_wxyz)
    assert {side: np.array_equal(hand, HAND) for side, hand in got.hands.items()} == {"left": True, "right": True}
    assert got.twist is not None
    assert np.array_equal(got.twist, np.linspace(-1.0, 1.0, 6))
    assert got.joints is not None
    assert np.array_equal(got.joints, np.arange(7.0))


def test_every_key_of_a_device_has_a_contract_that_fits_what_is_written() -> None:
    values = readings.encode("pico", FULL) | readings.encode_status("pico", Status(state="live"))
    assert set(values) == set(readings.watched_keys("pico"))
    for key, value in values.items():
        contract = contracts.contract(key)
        assert contract is not None, key
        assert contract.role == "sensor"
        if contract.codec == "f64" and contract.elements:
            assert len(codec.parse_f64(value)) == len(contract.elements), key
        assert len(set(contract.names)) == len(contract.names)
    assert contracts.contract(keys.stamp(keys.operator_head("pico"))) is None


def test_a_part_that_the_newest_sample_lacks_is_not_taken_from_an_older_one() -> None:
    samples = written(FULL) | written(OperatorSample(capture_ns=124, controls={"left_trigger": 0.5}))
    got = readings.decode("pico", samples)
    assert got.controls == {"left_trigger": 0.5}
    assert (got.head, got.left, got.right, got.body, dict(got.hands)) == (None, None, None, None, {})


def test_without_a_status_there_is_no_sample() -> None:
    samples = on_the_bus(readings.encode("pico", FULL))
    assert readings.decode_status("pico", samples) is None
    assert readings.decode("pico", samples).head is None


@pytest.mark.parametrize(
    ("part", "value", "complaint"),
    [
        ("operator_head_pico", b"abc", "3 bytes, expected a multiple of 8"),
        ("operator_head_pico", codec.f64([0.0] * 8), "8 values, expected 7"),
        ("operator_left_pico", codec.f64([0.0] * 7), "a quaternion is not of unit length"),
        ("operator_right_pico", codec.f64([np.nan, 0, 0, 1, 0, 0, 0]), "not finite"),
        ("operator_body_quat_pico", codec.f64(np.zeros(96)), "a quaternion is not of unit length"),
        ("operator_controls_pico", b"[1]", "Expected `object`"),
        ("operator_controls_pico", b'{"a": "b"}', "Expected `float`"),
        ("operator_controls_pico", json.dumps({str(n): 0 for n in range(300)}).encode(), "300 controls"),
        ("operator_status_pico", b'{"state": "fine"}', "Invalid enum value"),
    ],
)
def test_what_no_device_server_wrote_is_refused_with_its_key(part: str, value: bytes, complaint: str) -> None:
    samples = written(FULL) | on_the_bus({part: value})
    with pytest.raises(codec.BadValue, match=f"^{part}: ") as refusal:
        readings.decode("pico", samples)
    assert complaint in str(refusal.value)


def test_a_sample_of_the_wrong_shape_is_not_written() -> None:
    with pytest.raises(ValueError, match=r"twist has shape \(3,\), expected \(6,\)"):
        readings.encode("pico", OperatorSample(twist=np.zeros(3)))
