"""What C and Python both say is the same: limits, codes, records, and the hashes of types."""

from __future__ import annotations

import re

import pytest

from adapters.robots.g1.dds import guard_client, guard_limits
from adapters.robots.g1.dds.guard_client import Answer, GuardClient, Kind, Reason, Refusal, State
from station.errors import ConfigError
from tests.tiers import ROOT

SOURCE = ROOT / "bridges/g1_guard/src"
DATAGRAM = (SOURCE / "datagram.h").read_text(encoding="utf-8")


def test_the_limits_are_those_of_the_joint_table():
    assert (SOURCE / "limits.h").read_text(encoding="utf-8") == guard_limits.header(), (
        "python -m adapters.robots.g1.dds.guard_limits > bridges/g1_guard/src/limits.h"
    )


@pytest.mark.parametrize(("kind", "prefix"), [(Kind, "KIND"), (Answer, "ANSWER"), (State, "STATE"), (Reason, "REASON"),
                                              (Refusal, "REFUSED")])  # fmt: skip
def test_codes_are_the_same_in_c(kind, prefix):
    listed = list(dict.fromkeys(re.findall(rf"\b{prefix}_([A-Z_]+)(?= = |,)", DATAGRAM)))
    assert listed == [code.name for code in sorted(kind)]
    assert sorted(kind) == list(range(min(kind), min(kind) + len(kind)))


def test_records_have_the_sizes_of_the_structs():
    sizes = guard_client.SHORT.itemsize, guard_client.COMMAND.itemsize, guard_client.ANSWER.itemsize
    assert sizes == (36, 384, 256)
    assert f"SHORT_SIZE == {sizes[0]} && COMMAND_SIZE == {sizes[1]}" in DATAGRAM
    assert f"sizeof(struct answer) == {sizes[2]}" in DATAGRAM


def test_fields_of_an_answer_stand_in_the_same_order():
    body = DATAGRAM[DATAGRAM.index("struct answer {") :]
    lines = re.sub(r"//.*", "", body[: body.index("};")]).split(";")
    fields = [
        name
        for line in lines
        for name in re.findall(r"\b(\w+)(?:\[\w+\])?(?=,|$)", line.strip().split("{")[-1].strip())
    ]
    assert fields == list(guard_client.ANSWER.names)


def test_every_reason_has_words():
    assert set(guard_client.WORDS) == set(Reason)


@pytest.mark.parametrize("damage", [
    lambda data: data[:-1], lambda data: b"X" + data[1:], lambda data: data[:12] + b"\x09" + data[13:],
    lambda data: b"", lambda data: bytes(256),
])  # fmt: skip
def test_what_is_no_answer_is_none(damage):
    import numpy as np

    record = np.zeros(1, guard_client.ANSWER)
    record["magic"], record["version"], record["kind"] = b"G1GS", 1, Answer.STATUS
    assert guard_client.status(guard_client.sealed(record)) is not None
    assert guard_client.status(damage(guard_client.sealed(record))) is None
    record["state"] = 99
    assert guard_client.status(guard_client.sealed(record)) is None


def test_a_client_without_a_guard_waits_for_nothing():
    with GuardClient(port=9) as client:
        client.arm()
        for _ in range(3):
            client.send(0, *[[0.0] * 29] * 3)
            assert client.poll() is None
        assert not client.is_armed
        assert client.silence_s == float("inf")


def test_an_address_that_is_none_is_named():
    with pytest.raises(ConfigError, match=r"guard at 300\.0\.0\.1:5"):
        GuardClient("300.0.0.1", 5)
