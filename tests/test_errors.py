"""Errors are one line, and guess what was meant."""

from __future__ import annotations

import pytest

from station.errors import ConfigError, StationError, UnknownName, did_you_mean


@pytest.mark.parametrize(
    ("name", "meant"),
    [("motin", "motion"), ("rec", "recorder"), ("g1", "g1"), ("r", None), ("zebra", None)],
)
def test_what_was_meant_is_a_beginning_or_a_near_miss(name: str, meant: str | None) -> None:
    expected = "" if meant is None else f" (did you mean {meant!r}?)"
    assert did_you_mean(name, ["g1", "motion", "recorder"]) == expected


def test_an_unknown_name_lists_what_is_known() -> None:
    error = UnknownName("server", "moton", ["recorder", "motion"])
    assert str(error) == "unknown server 'moton' (did you mean 'motion'?); known: motion, recorder"
    assert str(UnknownName("server", "moton", [])) == "unknown server 'moton'; known: none"


def test_a_usage_mistake_exits_with_2_and_the_world_with_1() -> None:
    assert (ConfigError("x").exit_code, StationError("x").exit_code) == (2, 1)
