"""What the emergency stop's key asks for."""

from __future__ import annotations

import pytest

from station.life.estop import read


@pytest.mark.parametrize("data", [b"", b"0", b" 0\n", b'{"stop": false}', b'{"stop": false, "who": "anna"}'])
def test_these_values_reset(data: bytes) -> None:
    assert not read(data).stop


@pytest.mark.parametrize(
    "data",
    [b"1", b"stop", b"{}", b"[]", b'{"stop": true}', b'{"stop": 0}', b'{"stop": null}', b'{"stop": "false"}', b"\xff",
     b"null", b"false", b"00", b'{"stop": fal', b"[" * 9999],
)  # fmt: skip
def test_everything_else_stops(data: bytes) -> None:
    assert read(data).stop


def test_who_asked_and_why_are_kept() -> None:
    assert read(b'{"stop": true, "who": "anna", "reason": "smoke"}').reason == "anna, smoke"


def test_arming_is_asked_for_only_with_a_reset() -> None:
    assert read(b'{"stop": false, "arm": true}').arm
    assert not read(b'{"stop": true, "arm": true}').arm
    assert not read(b'{"stop": false, "arm": "yes"}').arm
    assert not read(b"0").arm
