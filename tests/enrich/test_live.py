"""What a running station shows of a key is what an enriched recording of it holds, to the last byte."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.bus import codec, keys, stamp
from station.bus.clocks import Offset
from station.bus.contracts import contract
from station.bus.sample import Sample
from station.bus.stamp import Stamp
from station.clock import SYSTEM
from station.contract import Contract, elements
from station.enrich import source
from station.enrich.enrich import enrich
from station.enrich.live import LiveKey, Topic, written_wall_ns
from station.enrich.vector import TypeNames
from station.episode.reading.reader import EpisodeReader, open_episode
from station.protobuf import foxglove, schema
from tests.enrich.read_back import decoded, topics
from tests.enrich.recordings import filmed, jpeg, walked
from tests.episode.filming import cloud

TOP = keys.lidar_cloud("top")
WALL_NS = 1_800_000_000_123_456_789


def written(value: bytes, mark: Stamp | None = None) -> Sample:
    return Sample("k", value, mark, None)


def shown(contract: Contract | None, value: bytes, key: str = "k") -> list[bytes] | None:
    return LiveKey(key, contract, "station.K").encode(written(value), WALL_NS)


def encoded_live(reader: EpisodeReader) -> dict[str, list[tuple[bytes, int]]]:
    """Return what a live station would have sent of everything that was recorded: bytes and log time by typed topic."""
    names, live = TypeNames(), dict[str, LiveKey]()
    found: dict[str, list[tuple[bytes, int]]] = {}
    for message in reader.messages(stamps=True):
        if message.channel.is_deletion or message.channel.contract is None:
            continue
        if (key := message.topic) not in live:
            live[key] = LiveKey(key, message.channel.contract, names.new(key))
        mark = None if message.stamp is None else stamp.decode(message.stamp)
        sent = live[key].encode(Sample(key, message.data, mark, None), message.publish_ns)
        for topic, data in zip(live[key].topics, sent or (), strict=True):
            if topic.encoding == "protobuf":
                found.setdefault(topic.name, []).append((data, message.publish_ns))
    return found


@pytest.mark.parametrize("kind", ["walked", "filmed"])
def test_typed_topics_of_a_running_station_are_those_of_its_enriched_recording(tmp_path: Path, kind: str) -> None:
    folder = walked(tmp_path) if kind == "walked" else filmed(tmp_path / "filmed", [jpeg(1), jpeg(2)], [None, 5])
    enrich(open_episode(folder))
    live, path = encoded_live(open_episode(folder)), folder / source.ENRICHED
    of_vectors_and_pictures = {topic: name for topic, name in topics(path).items() if topic in live}
    assert len(live) >= (10 if kind == "walked" else 1)
    assert set(live) == set(of_vectors_and_pictures)
    for topic, sent in live.items():
        recorded = decoded(path, topic)
        assert [(one.message.SerializeToString(), one.publish_ns) for one in recorded] == [
            (type(recorded[0].message).FromString(data).SerializeToString(), at_ns) for data, at_ns in sent
        ]


def test_of_a_value_of_many_rows_the_newest_is_shown() -> None:
    rows = Contract(key="k", family="f", role="state", codec="f64-rows", elements=elements((("a", "b"), "rad")))
    message = schema.message_class(schema.Schema(*_schema(LiveKey("k", rows, "station.K").topics[0])))
    sent = shown(rows, codec.f64(np.arange(6.0)))
    assert sent is not None
    found = message.FromString(sent[0])
    assert (found.a, found.b) == (4.0, 5.0)
    assert shown(rows, codec.f64(np.arange(5.0))) is None
    assert shown(rows, b"") is None


def _schema(topic: Topic) -> tuple[str, bytes]:
    assert (topic.encoding, topic.schema_encoding) == ("protobuf", "protobuf")
    return topic.schema_name, topic.schema


@pytest.mark.parametrize(
    ("form", "value", "said"),
    [
        ("json", b'{"a": 1,  "b":[2]}', b'{"a": 1,  "b":[2]}'),
        ("json", b" 0 ", b'{"value": 0 }'),
        ("json", b'"word"', b'{"value":"word"}'),
        ("json", b"not json", None),
        ("json-vector", b"[1,2.50]", b'{"value":[1,2.50]}'),
        ("integer", b"7", b'{"value":7}'),
        ("text", b'say "so"', b'{"value":"say \\"so\\""}'),
        ("text", b"\xff", None),
        ("f64", np.array([1.5, np.nan]).tobytes(), b'{"value":[1.5,null]}'),
        ("f32", np.array([0.5], np.float32).tobytes(), b'{"value":[0.5]}'),
        ("f64", b"odd", None),
    ],
)
def test_what_has_no_names_is_json_and_always_an_object(form: Any, value: bytes, said: bytes | None) -> None:
    described = Contract(key="k", family="f", role="state", codec=form)
    assert shown(described, value) == (None if said is None else [said])
    (topic,) = LiveKey("k", described, "station.K").topics
    assert (topic.name, topic.encoding, topic.schema_encoding) == ("k", "json", "jsonschema")
    assert json.loads(topic.schema)["type"] == "object"


def test_a_key_that_nothing_describes_is_shown_where_it_is_json() -> None:
    assert shown(None, b"[1, 2]") == [b'{"value":[1, 2]}']
    assert shown(None, b"\x00\x01") is None
    odd = LiveKey("caf\udcc3", None, "station.K").topics[0]
    assert odd.name == "caf\\xc3"
    assert json.loads(odd.schema)["description"] == "nothing describes this key"


def test_a_cloud_is_that_of_the_file_with_the_time_at_which_it_was_taken() -> None:
    mark = Stamp(1, 5_000_000_000, WALL_NS, "top.1.boot.x", 4_000_000_000)
    live = LiveKey(TOP, contract(TOP), "station.K")
    sent = live.encode(written(cloud(1), mark), WALL_NS)
    assert sent is not None
    assert [topic.name for topic in live.topics] == [TOP]
    found = schema.message_class(foxglove.schema(foxglove.POINT_CLOUD)).FromString(sent[0])
    assert found.timestamp.ToNanoseconds() == WALL_NS - 1_000_000_000
    assert sent[0].endswith(cloud(1))
    assert live.encode(written(b"no cloud"), WALL_NS) is None


def test_a_value_was_written_when_its_stamp_says_so() -> None:
    ours = Stamp(1, 5, WALL_NS, f"g1.1.{stamp.boot_id()}.x")
    assert written_wall_ns(written(b"", ours), SYSTEM) == WALL_NS
    stranger = Stamp(1, 5, WALL_NS, "g1.1.elsewhere.x")
    assert written_wall_ns(written(b"", stranger), SYSTEM) == WALL_NS, "all that is known of it"


def test_a_writer_of_another_machine_is_dated_by_the_clock_of_this_one() -> None:
    wrong = Stamp(1, 2_000_000_000, WALL_NS, "g1.1.elsewhere.x")
    now_ns = SYSTEM.monotonic_ns()
    sample = Sample("k", b"", wrong, now_ns, Offset(now_ns - 3_000_000_000, 1_000))  # it was written a second ago
    assert abs(SYSTEM.wall_ns() - 1_000_000_000 - written_wall_ns(sample, SYSTEM)) < 500_000_000


@pytest.mark.parametrize("wall_ns", [-1, -(1 << 63)])
def test_without_a_time_in_its_stamp_it_counts_from_its_arrival(wall_ns: int) -> None:
    now_ns = SYSTEM.monotonic_ns()
    hostile = Stamp(1, 5, wall_ns, f"g1.1.{stamp.boot_id()}.x")
    for mark in (None, hostile):
        age_s = (SYSTEM.wall_ns() - written_wall_ns(Sample("k", b"", mark, now_ns - 4_000_000_000), SYSTEM)) * 1e-9
        assert age_s == pytest.approx(4.0, abs=0.5)
        assert abs(SYSTEM.wall_ns() - written_wall_ns(Sample("k", b"", mark, None), SYSTEM)) < 500_000_000


def test_two_keys_never_share_a_message_type() -> None:
    names = TypeNames()
    assert [names.new(key) for key in ("a_b", "a:b", "c")] == ["station.AB", "station.AB_2", "station.C"]
