"""Configuration from YAML and --set: every problem is one line that says where and what."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
import pytest

from station import config
from station.errors import BadFile, ConfigError


class Inner(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    gain: float = 1.0


class Outer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    name: str
    rate_hz: float = 50.0
    pace: Literal["wall", "state"] | None = None
    inner: Inner = Inner()
    sides: tuple[Literal["left", "right"], ...] = ()
    shares: dict[Literal["left", "right"], float] = {}
    modes: list[dict[str, Literal["on", "off"]]] = []
    range: tuple[float, str] = (0.0, "m")


def test_values_fill_the_type() -> None:
    made = config.build(Outer, {"name": "a", "inner": {"gain": 2}}, where="x.yaml")
    assert made == Outer(name="a", inner=Inner(gain=2.0))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"name": "a", "rate_hs": 3},
            "x.yaml: unknown key 'rate_hs' (did you mean 'rate_hz'?); known: inner, modes, name, pace, range, rate_hz, "
            "shares, sides",
        ),
        ({"name": "a", "rate_hz": "fast"}, "x.yaml: rate_hz: expected float, got 'fast'"),
        ({"rate_hz": 1.0}, "x.yaml: missing key name"),
        ({"name": "a", "pace": "stat"}, "x.yaml: pace: expected state or wall, got 'stat' (did you mean 'state'?)"),
        ({"name": "a", "inner": {"gain": "big"}}, "x.yaml: inner.gain: expected float, got 'big'"),
        ({"name": "a", "inner": 3}, "x.yaml: inner: expected a mapping, got 3"),
        ({"name": "a", "inner": {"gian": 1}}, "x.yaml: inner: unknown key 'gian' (did you mean 'gain'?); known: gain"),
        (
            {"name": "a", "sides": ["left", "rigt"]},
            "x.yaml: sides[1]: expected left or right, got 'rigt' (did you mean 'right'?)",
        ),
        ({"name": "a", "sides": [3]}, "x.yaml: sides[0]: expected str, got 3"),
        ({"name": "a", "shares": {"left": 1, "rigt": 2}}, "x.yaml: shares: expected left or right, got 'rigt'"),
        ({"name": "a", "shares": {3: 1}}, "x.yaml: shares: expected str, got int"),
        ({"name": "a", "shares": {"left": "x"}}, "x.yaml: shares[...]: expected float, got str"),
        ({"name": "a", "modes": [{}, {"k": "of"}]}, "x.yaml: modes[1][...]: expected off or on, got 'of'"),
        ({"name": "a", "range": [0, 3]}, "x.yaml: range[1]: expected str, got 3"),
    ],
)
def test_a_mistake_names_the_place_the_key_and_the_remedy(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config.build(Outer, values, where="x.yaml")
    assert str(caught.value).startswith(message)


def test_set_options_reach_their_server() -> None:
    found = config.overrides(
        ["motion.motion=twist2:motions/a.pkl", "g1.gate.hold_after_s=0.2"], servers=["g1", "motion"]
    )
    assert found == {"motion": {"motion": "twist2:motions/a.pkl"}, "g1": {"gate": {"hold_after_s": 0.2}}}
    assert config.overrides(["loop=true"], servers=None) == {"": {"loop": True}}


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("motion", "expected server.key=value"),
        ("loop=true", "expected server.key=value"),
        ("moton.loop=true", "no server 'moton' (did you mean 'motion'?)"),
        ("motion.loop=[1", "not YAML"),
    ],
)
def test_a_bad_set_option_is_refused(option: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config.overrides([option], servers=["g1", "motion"])
    assert message in str(caught.value)
    assert option in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"), [("20s", 20.0), ("500ms", 0.5), ("2min", 120.0), (7, 7.0), ("1.5 s", 1.5)]
)
def test_durations(text: str | float, expected: float) -> None:
    assert config.seconds(text, where="--for") == expected


def test_a_bad_duration_says_what_one_looks_like() -> None:
    with pytest.raises(ConfigError, match="--for: expected a duration such as 20s"):
        config.seconds("soon", where="--for")


def test_a_number_with_an_exponent_is_a_number() -> None:
    assert config.overrides(["a=1e9", "b=-2.5E-3", "c=1e"], servers=None) == {"": {"a": 1e9, "b": -2.5e-3, "c": "1e"}}


def test_a_file_that_is_no_yaml_says_where(tmp_path: Path) -> None:
    path = tmp_path / "book.yaml"
    path.write_text("a: [1\nb: 2")
    with pytest.raises(ConfigError, match=r"book\.yaml: not YAML at line \d"):
        config.read_yaml(path)
    path.write_text("- a")
    with pytest.raises(ConfigError, match="expected a mapping"):
        config.read_yaml(path)
    with pytest.raises(BadFile, match=r"no such file \(did you mean 'book\.yaml'\?\)"):
        config.read_yaml(tmp_path / "boook.yaml")


def test_merging_reaches_into_mappings_and_leaves_the_base_alone() -> None:
    base = {"a": {"x": 1, "y": 2}, "b": 1}
    assert config.merged(base, {"a": {"y": 3}, "c": 4}) == {"a": {"x": 1, "y": 3}, "b": 1, "c": 4}
    assert base == {"a": {"x": 1, "y": 2}, "b": 1}
