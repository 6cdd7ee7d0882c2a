"""Plain data cut to a size: what is small stays whole, nothing grows, and what is left is what a reader takes."""

from __future__ import annotations

from typing import Any

import msgspec
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from station.episode.storage.bounds import cut, size_of
from station.episode.storage.manifest import Event, Stream
from tests.examples import examples

TEXT = st.one_of(st.text(max_size=30), st.text(st.sampled_from("a'\n \x01é\U0010ffff"), max_size=400))
VALUE = st.recursive(
    st.one_of(TEXT, st.integers(-(2**63), 2**64 - 1), st.floats(allow_nan=False), st.booleans(), st.none()),
    lambda inner: st.one_of(st.lists(inner, max_size=6), st.dictionaries(TEXT, inner, max_size=6)),
    max_leaves=40,
)


@settings(max_examples=examples(300))
@given(VALUE, st.integers(0, 3_000))
def test_what_is_cut_has_the_size_and_what_is_not_cut_is_the_same(value: Any, most: int) -> None:
    found = cut(value, most)
    assert size_of(found.value) <= max(most, 120)
    assert cut(found.value, most).value == found.value, "a second time nothing is left to cut"
    if size_of(value) <= most:
        assert found == (value, 0)
    else:
        assert found.cuts or size_of(found.value) <= 120


def test_the_small_members_stay_whole_and_the_large_ones_share_what_is_left() -> None:
    value = {"a": "x" * 10_000, "b": [1] * 1_000, "c": {"name": "g1", "gains": [1.5, 2.5]}, "d": "y" * 10_000}
    found = cut(value, 8_000).value
    assert found["c"] == value["c"]
    assert abs(len(found["a"]) - len(found["d"])) <= 1
    assert 2_000 < len(found["a"]) < 3_000
    assert 20 < len(found["b"]) < 80
    assert found["a"].endswith("x... (10000 characters)")


def test_a_struct_keeps_every_field_and_can_be_made_again() -> None:
    streams = [Stream(key="k" * 1_000, source="s" * 1_000, count=n) for n in range(100)]
    events = [Event(at_s=1.0, name="n" * 1_000, numbers={"text": "t" * 1_000}) for _ in range(100)]
    for values, most in ((streams, 50_000), (events, 20_000)):
        found = cut(values, most)
        again = msgspec.convert(found.value, list[type(values[0])])  # type: ignore[misc]
        assert 10 < len(again) <= 100
        assert found.cuts >= 100


def test_an_integer_beyond_64_bits_is_a_text_and_what_is_nested_deeper_than_a_reader_takes_is_left_out() -> None:
    assert cut([2**64 - 1, -(2**64), 2**64], 1_000) == (
        [2**64 - 1, str(-(2**64)), str(2**64)], 2,
    )  # fmt: skip
    objects: Any = 1
    lists: Any = 1
    for _ in range(45):
        objects, lists = {"a": objects}, [lists]
    found = cut(objects, 100_000)
    assert found.cuts == 1
    assert yaml.safe_dump(found.value).count("a:") == 41
    found = cut(lists, 100_000)
    assert (found.cuts, str(found.value).count("[")) == (1, 42)  # the innermost one is empty
