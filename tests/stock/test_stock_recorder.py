"""What a stock TWIST2 recorder reads of our keys: thirty looks a second, buttons from ``controller_data``."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from station.bus.client import Bus
from tests.stock.conftest import OpenBus, Serve
from tests.stock.stock_trials import rows_of_our_servers
from tests.stock.stock_twist2 import Recorder, press
from tests.waiting import wait_until


@pytest.fixture
def stock(open_bus: OpenBus) -> Iterator[Recorder]:
    recorder = Recorder(open_bus.port, patience_s=5.0)
    yield recorder
    recorder.close()


def test_every_slot_of_a_row_is_filled_from_our_servers(bus: Bus, serve: Serve, stock: Recorder) -> None:
    rows = rows_of_our_servers(bus, serve, stock)
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
