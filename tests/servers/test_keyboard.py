"""The keyboard server as a process of its own, on real pseudo terminals and a real bus."""

from __future__ import annotations

import os
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.devices.keyboard.kind import KeyboardConfig
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.servers.device_station import Station, presses, station
from tests.waiting import DEADLINE_S


@pytest.fixture
def typist(bus_server: BusAddress, tmp_path: Path) -> Iterator[Station]:
    with station("keyboard", bus_server, tmp_path) as made:
        yield made


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A terminal as a person's: master and slave, lines and echo."""
    master, slave = os.openpty()
    yield master, slave
    os.close(master)
    os.close(slave)


def test_a_script_stands_on_the_bus_and_a_closed_terminal_is_lost_then_back(typist: Station) -> None:
    typist.start([{"at_s": 0.5, "press": "w", "for_s": 2.5}, {"at_s": 4.0, "plugged": False},
                  {"at_s": 6.0, "plugged": True}, {"at_s": 8.0, "press": "space", "for_s": 100.0}])  # fmt: skip
    typist.until_back("the terminal was closed", beside=lambda: typist.samples[-1].controls.get("key_space") == 1.0)
    assert presses(typist) >= 2, "pressed once, and a while later by auto-repeat"
    assert [name for name, value in typist.samples[-1].controls.items() if value] == ["key_space"]
    assert typist.facts["device"]["tells_release"] is False
    assert typist.stop() == 0


def test_a_real_terminal_is_put_back_when_the_server_is_asked_to_stop(
    typist: Station, terminal: tuple[int, int]
) -> None:
    master, slave = terminal
    before = termios.tcgetattr(slave)
    typist.start(tty=os.ttyname(slave))
    typist.until(lambda: typist.states() == ["live"])
    assert not termios.tcgetattr(slave)[3] & (termios.ICANON | termios.ECHO)
    os.write(master, b"x")
    typist.until(lambda: {sample.controls.get("key_x") for sample in typist.samples} == {0.0, 1.0})
    assert typist.stop() == 0
    assert termios.tcgetattr(slave) == before


def test_a_real_terminal_is_put_back_when_the_server_fails(typist: Station, terminal: tuple[int, int]) -> None:
    _, slave = terminal
    before = termios.tcgetattr(slave)
    broken = (
        "from adapters.devices.keyboard.device import Keyboard\n"
        "def read(self): raise RuntimeError('broken on purpose')\n"
        "Keyboard.read = read\n"
    )
    typist.start(before=broken, tty=os.ttyname(slave))
    assert typist.process.wait(DEADLINE_S) == 1
    assert "broken on purpose" in typist.last_words()
    assert termios.tcgetattr(slave) == before


def test_without_a_terminal_it_says_how_to_give_it_one(typist: Station) -> None:
    typist.start(before="import os; os.setsid()\n")  # as a supervisor's child is
    code, words = typist.ends()
    assert code == 1
    assert words.startswith("this process has no terminal; run `station up` or `station serve keyboard` in a terminal")


def test_what_is_no_terminal_is_refused(typist: Station) -> None:
    typist.start(tty="/dev/null")
    code, words = typist.ends()
    assert code == 1
    assert words.startswith("/dev/null: is no terminal; ")


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"rate_hz": 5}, "rate_hz is 5; expected 10 to 500 Hz"),
        ({"hold_s": 2.0}, "hold_s is 2; expected 0.05 to 0.5 s: a longer jog is a run-away"),
    ],
)
def test_bad_settings_are_one_line(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(KeyboardConfig, values, where="server keyboard")
    assert told in str(caught.value)
