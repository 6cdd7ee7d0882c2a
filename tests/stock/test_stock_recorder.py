"""What a stock TWIST2 recorder reads of our keys: thirty looks a second, buttons from ``controller_data``."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from station.bus import keys
from station.bus.client import Bus
from tests.lateness import TooLate, Waits, excuse
from tests.stock.conftest import OpenBus, Serve
from tests.stock.stock_twist2 import ACTIONS, STATES, Recorder, press
from tests.waiting import wait_until


@pytest.fixture
def stock(open_bus: OpenBus) -> Iterator[Recorder]:
    recorder = Recorder(open_bus.port, patience_s=5.0)
    yield recorder
    recorder.close()


def test_every_slot_of_a_row_is_filled_from_our_servers(bus: Bus, serve: Serve, stock: Recorder) -> None:
    serve("g1")
    serve("motion", "motion=builtin:wave")
    wait_until(lambda: bus.get(keys.T_ACTION) and bus.get(keys.T_STATE))
    rows, waits = [], Waits()
    for _ in range(15):
        rows.append(stock.item())
        time.sleep(1 / 30)
    waited_s = waits.seconds()
    for row in rows:
        lengths = {name: len(value) for name, value in row.items() if isinstance(value, list)}
        assert lengths == {**STATES, **ACTIONS}
        assert [type(row[name]) for name in ("t_state", "t_action")] == [int, int]
        if (apart_s := abs(row["t_state"] - row["t_action"]) * 1e-3) >= 1.0:
            excuse(TooLate("state and command of a row", apart_s - 1.0, waited_s))
    wait_until(lambda: rows[0]["t_state"] < stock.item()["t_state"])


def test_an_empty_bus_gives_rows_of_nothing(bus: Bus, stock: Recorder) -> None:
    assert set(stock.item().values()) == {None}


def test_buttons_must_be_written_by_somebody(bus: Bus, open_bus: OpenBus, stock: Recorder) -> None:
    with pytest.raises(TypeError):  # stock ends here: nobody has a headset on
        stock.is_button_pressed()
    press(stock.redis, button=False)
    assert not stock.is_button_pressed()
    press(stock.redis, button=True)
    assert stock.is_button_pressed()
