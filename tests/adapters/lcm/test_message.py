"""Types and messages: fingerprints as they are published, and LCM's own generated classes as a peer."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.lcm import types
from adapters.lcm.message import BadMessage, Field, MessageType
from tests.adapters.lcm.library import PACKAGES, generate, generated, sample

# Size and fingerprint: InternRobotics/OpenHomie and Improbable-AI/walk-these-ways, by LCM's own generator.
PINNED = (
    (types.STATE_ESTIMATOR, 144, 0x08BC31F1B8DA88F4),
    (types.BODY_CONTROL, 248, 0xF4F03934711BF8B5),
    (types.TARGETS, 480, 0x86DB34943194C221),
    (types.RC_COMMAND, 46, 0x8EE4D605D87CFBC5),
    (types.COMMAND, 40, 0xA0F4525D5254AFA0),
    (types.ARM_ACTION, 120, 0xD25E57D2AAC7F1FC),
    (types.HAND_ACTION, 120, 0xD25E57D2AAC7F1FC),
    (types.GO1_LEG_CONTROL, 272, 0x5352516A697F890F),
    (types.GO1_STATE_ESTIMATOR, 160, 0xD50F90505DFFCB6D),
    (types.GO1_TARGETS, 544, 0xDB10251DE2523982),
)


@pytest.fixture(scope="module")
def classes(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("generated")
    generate(folder)
    yield folder
    sys.path.remove(str(folder))
    for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
        del sys.modules[name]


def test_fingerprints_and_sizes_are_those_that_are_published() -> None:
    assert [(kind.size, kind.fingerprint) for kind, _, _ in PINNED] == [(size, mark) for _, size, mark in PINNED]
    assert [kind for kind, _, _ in PINNED] == list(types.ALL)


@pytest.mark.parametrize(
    ("package", "kind"), [(package, kind) for package, kinds in PACKAGES.items() for kind in kinds],
    ids=lambda each: getattr(each, "name", each),
)  # fmt: skip
def test_a_message_is_that_of_the_class_which_lcm_generates_both_ways(
    classes: Path, package: str, kind: MessageType
) -> None:
    values = sample(kind)
    theirs = generated(classes, package, kind.name)
    message = theirs()
    for name, value in values.items():
        setattr(message, name, value)
    assert theirs._get_packed_fingerprint() == kind.fingerprint.to_bytes(8, "big")
    assert kind.encode(values) == message.encode()
    assert kind.decode(message.encode()) == values
    decoded = theirs.decode(kind.encode(values))
    assert {name: getattr(decoded, name) for name in values} == values


def test_what_is_of_another_type_or_length_is_refused_with_a_reason() -> None:
    message = types.COMMAND.encode({"command": (0.5, 0.0, 0.1, 0.74)})
    with pytest.raises(BadMessage, match="39 bytes, expected the 40 of command_lcmt") as caught:
        types.COMMAND.decode(message[:-1])
    assert caught.value.kind == "length"
    with pytest.raises(BadMessage, match=r"fingerprint a1f4525d5254afa0, expected a0f4525d5254afa0") as caught:
        types.COMMAND.decode(b"\xa1" + message[1:])
    assert caught.value.kind == "fingerprint"


def test_arms_and_hands_cannot_be_told_apart_by_their_messages() -> None:
    act = tuple(range(14))
    assert types.HAND_ACTION.decode(types.ARM_ACTION.encode({"act": act})) == {"act": act}


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({}, "expected the fields command; got none"),
        ({"command": (1.0,) * 3}, "command is of 3 numbers, expected 4"),
        ({"command": 1.0}, "command is of 1 numbers, expected 4"),
        ({"command": ("a",) * 4}, "required argument is not a float"),
    ],
)
def test_what_is_no_value_of_a_type_is_not_encoded(values: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        types.COMMAND.encode(values)


def test_numbers_beyond_their_primitive_type_are_not_encoded() -> None:
    kind = MessageType("t", (Field("int8_t", "a"), Field("float", "b")))
    for values in ({"a": 200, "b": 0.0}, {"a": 1, "b": 1e300}):
        with pytest.raises(ValueError, match="t: "):
            kind.encode(values)
    assert math.isnan(kind.decode(kind.encode({"a": 1, "b": math.nan}))["b"])
