"""Whatever clients write while an episode is recorded: its manifest is one that our own reader takes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from station import safe_yaml
from station.bus import keys
from station.bus.stamp import new_source
from station.bus.tap import Write
from station.episode.reading.reader import open_episode
from station.episode.storage import layout
from station.episode.storage.manifest import Event, Manifest, dump_manifest, load_manifest, parse_manifest
from station.episode.writing.repair import repair
from tests.episode.recorded import recorded
from tests.episode.writes import Native, foreign
from tests.examples import examples

HASH, NUMBER, LONG = "deadbeef" * 30, int("1" * 201), "x" * 1_000_000
CLIENT = Native("client")


def event(name: str, **detail: Any) -> Write:
    return foreign(keys.EVENT, json.dumps({"name": name, "detail": detail}).encode())


def configured(server: str, facts: Any) -> Write:
    return foreign(keys.server_config(server), json.dumps(facts).encode())


def moved(number: int, **facts: Any) -> Write:
    facts = {"file": f"{number}.pkl", **facts}
    return foreign(keys.command_source("g1"), json.dumps(facts).encode())


def marked(number: int, label: str) -> Write:
    return CLIENT.request("mark", f"mark {number} {label[:4]}", label=label)


HOSTILE: dict[str, tuple[list[Write], set[str]]] = {
    "hashes where words are meant": (
        [event(HASH, **{HASH: HASH}), marked(0, HASH), foreign(HASH, b"1"), configured(HASH, {HASH: HASH}),
         moved(0, sha256=HASH)],
        set(),
    ),
    "integers of 201 digits": (
        [event("e", n=NUMBER), configured("g1", {"role": "low-level", "policy": {"rate_hz": NUMBER}}),
         moved(0, sha256=NUMBER)],
        {"events", "servers", "motions"},
    ),
    "long events": ([event("e", text="x" * 7_900) for _ in range(600)], {"events"}),
    "events of long names": ([event(LONG) for _ in range(20)], {"events"}),
    "long marks": ([marked(n, LONG) for n in range(10)], {"marks"}),
    "marks in characters that are escaped": ([marked(n, "\x01" * 1_900) for n in range(490)], {"marks"}),
    "long configurations": ([configured(f"s{n}", {"text": LONG}) for n in range(9)], {"servers"}),
    "configurations of many values": ([configured(f"s{n}", {str(i): i for i in range(19_000)}) for n in range(3)],
                                      {"servers"}),
    "a configuration of more than a megabyte": ([configured("g1", {"text": 2 * LONG})], {"servers"}),
    "a configuration that is nested deep": ([configured("g1", json.loads('{"a":' * 40 + "1" + "}" * 40))], {"servers"}),
    "long sources": ([moved(n, text="x" * 64_000) for n in range(190)], {"motions"}),
    "sources of many values": ([moved(n, values=[1] * 9_000) for n in range(20)], {"motions"}),
    "more sources than are listed": ([moved(n) for n in range(210)], {"motions"}),
    "many keys of long names": ([foreign(f"{n} {'k' * 20_000}", b"1") for n in range(300)], {"streams"}),
    "a count that no writer reaches": (
        [Write("n", b"1", b"%d 1 1 %s" % (n, CLIENT.source.encode()), 1) for n in (1, 10**4000, -(10**4000))], set()
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_manifest_can_be_read_whatever_was_written(name: str, tmp_path: Path) -> None:
    writes, shortened = HOSTILE[name]
    folder = recorded(tmp_path, writes)
    manifest = load_manifest(folder)
    assert manifest.state == "finished"
    assert set(manifest.shortened) == shortened
    assert open_episode(folder).manifest.recorder.messages >= len(writes) + 2, "the signals hold all of it"
    assert len(manifest.events) + manifest.events_not_listed == sum(write.key == keys.EVENT for write in writes)
    inside = open_episode(folder).attachments()[layout.MANIFEST]
    assert parse_manifest(inside, "inside").shortened == manifest.shortened


def test_what_is_small_stays_whole_beside_what_is_too_large(tmp_path: Path) -> None:
    facts = {"role": "low-level", "robot": "unitree_g1", "policy": {"name": "tracker", "gains": [1.5] * 29}}
    writes = [configured("g1", facts), *HOSTILE["long configurations"][0], marked(0, "here")]
    manifest = load_manifest(recorded(tmp_path, writes))
    assert manifest.servers["g1"] == facts
    assert (manifest.robot.suffix, manifest.policy.name) == ("unitree_g1", "tracker")
    assert [mark.label for mark in manifest.marks] == ["here"]
    assert manifest.servers["s0"]["text"].endswith("... (1000000 characters)")


@pytest.mark.parametrize("name", ["long marks", "integers of 201 digits", "more sources than are listed"])
def test_a_repair_counts_the_same(name: str, tmp_path: Path) -> None:
    folder = recorded(tmp_path, HOSTILE[name][0])
    before = load_manifest(folder)
    with (folder / layout.SIGNALS).open("r+b") as file:
        file.truncate((folder / layout.SIGNALS).stat().st_size - 1)
    assert repair(folder).state == "repaired"
    after = load_manifest(folder)
    told = ("events", "marks", "motions")
    assert [after.shortened.get(section) for section in told] == [before.shortened.get(section) for section in told]
    assert (after.marks, after.events, after.motions) == (before.marks, before.events, before.motions)


def test_saving_a_manifest_again_counts_nothing_twice(tmp_path: Path) -> None:
    folder = recorded(tmp_path, HOSTILE["long configurations"][0])
    once = dump_manifest(load_manifest(folder))
    assert dump_manifest(parse_manifest(once, "once")) == once


NO_WORDS = (HASH, "0x" + HASH, "1:" * 120 + "1", "1_" * 150, "9" * 300, "<<", "=", "~", "- a\n  b: c", "\ufeff")
ODD_TEXT = st.one_of(
    st.text(max_size=40),
    st.sampled_from(NO_WORDS),
    st.sampled_from(["\U0010ffff", "\n ", "'", "é", "\x00", "\t#"]).map(lambda part: part * 3_000),
)  # fmt: skip
ODD_VALUE = st.recursive(
    st.one_of(ODD_TEXT, st.none(), st.booleans(), st.floats(allow_nan=False), st.integers(-(10**900), 10**900)),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(ODD_TEXT, inner, max_size=4)),
    max_leaves=12,
)
ODD_WRITE = st.one_of(
    st.builds(lambda name, value: event(name, value=value), ODD_TEXT, ODD_VALUE),
    st.builds(lambda value: foreign(keys.EVENT, json.dumps(value).encode()), ODD_VALUE),
    st.builds(lambda name, value: configured(name, {"role": "low-level", "policy": value}), ODD_TEXT, ODD_VALUE),
    st.builds(lambda text, value: moved(0, sha256=text, more=value), ODD_TEXT, ODD_VALUE),
    st.builds(marked, st.integers(0, 999), ODD_TEXT),
    st.builds(foreign, ODD_TEXT, st.one_of(st.none(), st.binary(max_size=20))),
    st.builds(lambda key, stamp: Write(key, b"1", stamp, 1), ODD_TEXT, st.binary(max_size=30)),
)
folders: Iterator[int] = itertools.count()


@settings(max_examples=examples(30), suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.lists(st.tuples(ODD_WRITE, st.sampled_from([1, 1, 50])), max_size=10))
def test_any_mix_of_writes_leaves_a_manifest_that_can_be_read(tmp_path: Path, mix: list[tuple[Write, int]]) -> None:
    folder = recorded(tmp_path / str(next(folders)), [write for write, times in mix for _ in range(times)])
    manifest = load_manifest(folder)
    assert manifest.state == "finished"
    assert dump_manifest(manifest) == dump_manifest(parse_manifest(dump_manifest(manifest), "again"))


@settings(max_examples=examples(100))
@given(ODD_VALUE)
def test_any_plain_data_can_be_written_and_read(value: Any) -> None:
    manifest = Manifest(runbook={"value": value}, quality={"value": value}, events=[Event(at_s=0.0, name="e")])
    found = parse_manifest(dump_manifest(manifest), "it")
    assert found.events == manifest.events
    assert found.shortened or found.runbook == manifest.runbook


def test_a_plain_hash_of_any_length_is_text_and_a_number_of_that_length_is_refused() -> None:
    assert safe_yaml.load(f"a: {HASH}") == {"a": HASH}
    for number in ("9" * 200, "0x" + "f" * 300, "1:" * 120 + "1", "0." + "1" * 300, "!!int " + "9" * 300):
        with pytest.raises(safe_yaml.BadYaml, match="a number of"):
            safe_yaml.load(f"a: {number}")


def test_a_source_as_long_as_a_key_may_be_leaves_a_stream_that_can_be_read(tmp_path: Path) -> None:
    source = new_source("s" * 100_000).encode()
    folder = recorded(tmp_path, [Write(f"k{n}", b"1", b"1 1 1 " + source, 1) for n in range(30)])
    assert len(load_manifest(folder).streams) >= 30
