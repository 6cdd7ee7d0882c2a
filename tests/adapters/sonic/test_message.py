"""SONIC's packed messages: byte for byte those of its own builders, and nothing but such messages is read."""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.sonic.message import HEADER_BYTES, MOST_BYTES, BadMessage, pack, parse, topic_of
from adapters.sonic.planner import Order, Planned, order_of, pack_order, pack_planned, planned_of
from adapters.sonic.pose import StreamedPose, frame_of
from tests.adapters.sonic.stock import stock


@pytest.mark.assets
def test_orders_and_plans_are_byte_for_byte_those_of_sonics_own_builders(assets: Path) -> None:
    theirs, rng = stock(assets), random.Random(1)
    for number in range(200):
        flags = [bool(number & bit) for bit in (1, 2, 4)]
        assert pack_order(Order(*flags)) == theirs.build_command_message(*flags)
        movement, facing = ([rng.uniform(-1, 1) for _ in range(3)] for _ in range(2))
        planned = Planned(rng.randrange(27), tuple(movement), tuple(facing), rng.uniform(-1, 3), rng.uniform(-1, 1))
        assert pack_planned(planned) == theirs.build_planner_message(*planned)


@pytest.mark.assets
def test_a_streamed_pose_is_byte_for_byte_what_sonics_own_builder_makes_of_its_fields(assets: Path) -> None:
    theirs, streamed = stock(assets), StreamedPose()
    for number in range(20):
        ours = streamed.pack(FORMAT.default + 0.001 * number, 0.02)
        fields = dict(parse("pose", ours).fields)
        assert list(fields) == ["body_quat", "frame_index", "joint_pos", "joint_vel"]
        assert ours == theirs.pack_pose_message(fields, topic="pose", version=1)
    for fields in ({"token_state": np.arange(64, dtype=np.float32)}, {"a": np.zeros((2, 3)), "b": np.array([True])}):
        assert pack("pose", 4, fields) == theirs.pack_pose_message(fields, version=4)


@pytest.mark.assets
def test_what_sonics_own_builders_make_is_read_with_every_optional_field(assets: Path) -> None:
    theirs = stock(assets)
    order = order_of(parse("command", theirs.build_command_message(True, False, True, delta_heading=0.1)))
    assert order == Order(start=True, stop=False, is_planner=True)
    data = theirs.build_planner_message(
        2, [1, 0, 0], [0, 1, 0], 0.5, -1.0, [0.1] * 17, [0.0] * 17, [0.2] * 7, [0.3] * 7, [0.0] * 9, [1, 0, 0, 0] * 3,
        [0.5] * 3,
    )  # fmt: skip
    said = parse("planner", data)
    assert planned_of(said) == Planned(2, (1, 0, 0), (0, 1, 0), 0.5, -1.0)
    assert said.fields["vr_orientation"].tolist() == [1, 0, 0, 0] * 3


def test_sizes_are_those_that_were_measured_of_sonics_programs() -> None:
    assert HEADER_BYTES == 1280
    assert len(pack_planned(Planned(0, (0, 0, 0), (1, 0, 0)))) == 1323
    assert len(pack_order(Order(True, False, True))) == 1290
    four = {"body_quat": np.zeros((4, 4), np.float32), "frame_index": np.zeros(4, np.int64),
            "joint_pos": np.zeros((4, 29), np.float32), "joint_vel": np.zeros((4, 29), np.float32)}  # fmt: skip
    assert len(pack("pose", 1, four)) == 2308


def header(**changes: object) -> bytes:
    told = {"v": 1, "endian": "le", "count": 1, "fields": [{"name": "mode", "dtype": "i32", "shape": [1]}]} | changes
    return json.dumps(told).encode().ljust(HEADER_BYTES, b"\0")


FIELD = {"name": "mode", "dtype": "i32", "shape": [1]}
BAD = {
    "empty": (b"", "wrong-length"),
    "another topic": (b"command" + header() + bytes(4), "wrong-header"),
    "short header": (b"planner" + header()[:100], "wrong-length"),
    "no JSON": (b"planner" + b"{".ljust(HEADER_BYTES, b"\0") + bytes(4), "wrong-header"),
    "deep JSON": (b"planner" + (b"[" * 1279).ljust(HEADER_BYTES, b"\0"), "wrong-header"),
    "behind the header": (b"planner" + header()[:-1] + b"x" + bytes(4), "wrong-header"),
    "no fields": (b"planner" + header(fields=None) + bytes(4), "wrong-header"),
    "a type of its own": (b"planner" + header(fields=[FIELD | {"dtype": "O"}]) + bytes(4), "wrong-header"),
    "no shape": (b"planner" + header(fields=[FIELD | {"shape": []}]) + bytes(4), "wrong-header"),
    "negative": (b"planner" + header(fields=[FIELD | {"shape": [-1]}]) + bytes(4), "wrong-header"),
    "huge": (b"planner" + header(fields=[FIELD | {"shape": [10**15]}]) + bytes(4), "wrong-header"),
    "huge product": (b"planner" + header(fields=[FIELD | {"shape": [2**17] * 4}]) + bytes(4), "wrong-length"),
    "twice": (b"planner" + header(fields=[FIELD, FIELD]) + bytes(8), "wrong-header"),
    "too little": (b"planner" + header() + bytes(3), "wrong-length"),
    "too much": (b"planner" + header() + bytes(5), "wrong-length"),
    "endless": (b"planner" + header() + bytes(MOST_BYTES), "wrong-length"),
    "another endian": (b"planner" + header(endian="middle") + bytes(4), "wrong-header"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_message_is_refused_with_its_reason(name: str) -> None:
    data, kind = BAD[name]
    with pytest.raises(BadMessage) as caught:
        parse("planner", data)
    assert caught.value.kind == kind


def test_the_byte_order_that_a_header_says_is_that_of_its_numbers() -> None:
    data = b"planner" + header(endian="be") + (7).to_bytes(4, "big")
    assert parse("planner", data).number("mode", 0, among=("i32",)) == 7


def test_a_topic_ends_where_the_header_begins() -> None:
    topics = ("command", "planner")
    assert topic_of(b"planner" + header(), topics) == "planner"
    assert topic_of(b"planners" + header(), topics) == ""
    assert topic_of(b"pose" + header(), topics) == ""


GOOD = {"mode": np.array([1], np.int32), "movement": np.zeros(3, np.float32), "facing": np.zeros(3, np.float32)}


@pytest.mark.parametrize(
    ("changed", "kind"),
    [
        ({"mode": np.array([1.0], np.float32)}, "wrong-fields"),
        ({"movement": np.zeros(4, np.float32)}, "wrong-fields"),
        ({"movement": np.array([np.nan, 0, 0], np.float32)}, "not-finite"),
        ({"speed": np.array([np.inf], np.float32)}, "not-finite"),
        ({"height": np.zeros((1, 1), np.float32)}, "wrong-fields"),
    ],
)
def test_a_plan_of_other_types_shapes_or_numbers_is_refused(changed: dict[str, np.ndarray], kind: str) -> None:
    planned_of(parse("planner", pack("planner", 1, GOOD)))
    with pytest.raises(BadMessage) as caught:
        planned_of(parse("planner", pack("planner", 1, GOOD | changed)))
    assert caught.value.kind == kind


def test_another_version_and_a_field_that_lacks_are_refused() -> None:
    with pytest.raises(BadMessage, match="version 2, expected 1"):
        planned_of(parse("planner", pack("planner", 2, GOOD)))
    with pytest.raises(BadMessage, match="field facing lacks"):
        planned_of(parse("planner", pack("planner", 1, {name: GOOD[name] for name in ("mode", "movement")})))
    with pytest.raises(BadMessage, match="version 4, expected 1: joints, no SMPL, no tokens"):
        frame_of(parse("pose", pack("pose", 4, {"token_state": np.zeros(64, np.float32)})))
