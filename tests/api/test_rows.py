"""A key whose values are many rows: the newest of them is what it holds now."""

from __future__ import annotations

import numpy as np
import pytest

from station.api.live import Value
from station.bus import codec
from station.bus.sample import Sample
from station.cli import describe
from station.contract import Contract, elements
from station.errors import UsageError

ROWS = Contract(
    key="state_samples_x", family="station", role="state", codec="f64-rows", elements=elements((("tick", "b"), "ms"))
)


def _value(data: bytes) -> Value:
    return Value(Sample(ROWS.key, data, None, 0), ROWS)


def test_the_newest_row_is_its_vector_and_what_describe_shows(capsys):
    value = _value(codec.f64(np.arange(6.0)))
    assert value.named() == {"tick": 4.0, "b": 5.0}
    describe._print_key(ROWS, value)
    assert "fit" not in capsys.readouterr().out


@pytest.mark.parametrize("data", [b"", b"123", bytes(24)])
def test_what_is_no_row_is_said(data):
    with pytest.raises(UsageError, match=r"state_samples_x: \d+ bytes; expected rows of 2 numbers"):
        _value(data).vector()
