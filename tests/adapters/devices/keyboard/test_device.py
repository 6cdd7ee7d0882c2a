"""The keyboard adapter on real pseudo terminals."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.fakes.keyboard import install
from adapters.devices.fakes.keyboard.typist import FakeTerminal, Typing, TypistStep
from adapters.devices.fakes.script import Script
from adapters.devices.keyboard.device import Keyboard
from station.errors import BadFile
from station.operator.device import Device, DeviceError
from tests.adapters.devices.by_hand import HandClock
from tests.waiting import DEADLINE_S, wait_until

Open = Callable[..., Keyboard]


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A terminal as a person's: master and slave, lines and echo."""
    master, slave = os.openpty()
    yield master, slave
    for end in (master, slave):
        try:
            os.close(end)
        except OSError:
            continue  # a test has closed it


@pytest.fixture
def opened(terminal: tuple[int, int], clock: HandClock) -> Iterator[Open]:
    devices: list[Keyboard] = []

    def begin(**options: Any) -> Keyboard:
        devices.append(Keyboard(**{"tty": os.ttyname(terminal[1]), "clock": clock, **options}))
        return devices[-1]

    yield begin
    for device in devices:
        device.close()


def held(device: Keyboard) -> set[str]:
    reading = device.read()
    assert reading is not None
    return {name.removeprefix("key_") for name, value in reading.controls.items() if value}


def typed(device: Keyboard, terminal: tuple[int, int], data: bytes) -> None:
    """Type, and wait until it can be read."""
    os.write(terminal[0], data)
    wait_until(lambda: select.select([device._terminal], [], [], 0.0)[0])


def test_nobody_types_and_the_keyboard_is_live(opened: Open) -> None:
    device = opened()
    assert isinstance(device, Device)
    for _ in range(3):
        assert held(device) == set(), "silence is rest, not loss"
    reading = device.read()
    assert reading is not None
    assert {"key_space", "key_w", "key_up", "key_f12"} <= set(reading.controls)


def test_a_press_counts_as_held_for_a_moment_and_repeats_make_it_longer(
    opened: Open, terminal: tuple[int, int], clock: HandClock
) -> None:
    device = opened(hold_s=0.15)
    typed(device, terminal, b"w")
    assert held(device) == {"w"}
    clock.pass_(0.14)
    assert held(device) == {"w"}
    typed(device, terminal, b"w")
    assert held(device) == {"w"}
    clock.pass_(0.14)
    assert held(device) == {"w"}
    clock.pass_(0.02)
    assert held(device) == set()
    reading = device.read()
    assert reading is not None
    assert reading.controls["key_w"] == 0.0, "that it is up is said, not left out"


def test_two_hundred_keys_are_taken_in_by_one_call(opened: Open, terminal: tuple[int, int]) -> None:
    device = opened()
    typed(device, terminal, b"a" * 100 + b"b" * 99 + b"\x1b[A")
    assert held(device) == {"a", "b", "up"}
    assert device._waiting == b""


def test_an_escape_alone_is_a_key_after_a_moment(opened: Open, terminal: tuple[int, int], clock: HandClock) -> None:
    device = opened()
    typed(device, terminal, b"\x1b")
    assert held(device) == set()
    clock.pass_(0.05)
    assert held(device) == {"escape"}


def test_an_arrow_in_two_pieces_is_an_arrow(opened: Open, terminal: tuple[int, int]) -> None:
    device = opened()
    typed(device, terminal, b"\x1b[")
    assert held(device) == set()
    typed(device, terminal, b"D")
    assert held(device) == {"left"}


def test_what_was_typed_before_is_nobodys_command(terminal: tuple[int, int], opened: Open) -> None:
    os.write(terminal[0], b"estop\n")
    assert select.select([terminal[1]], [], [], DEADLINE_S)[0], "it has come: the kernel hands it over a little later"
    assert held(opened()) == set()


def test_the_terminal_shows_nothing_and_is_put_back(terminal: tuple[int, int], opened: Open) -> None:
    before = termios.tcgetattr(terminal[1])
    device = opened()
    changed = termios.tcgetattr(terminal[1])
    assert not changed[3] & (termios.ICANON | termios.ECHO)
    assert changed[3] & termios.ISIG, "Ctrl-C stays a signal"
    device.close()
    assert termios.tcgetattr(terminal[1]) == before
    device.close()


@pytest.mark.usefixtures("processes")
def test_a_process_that_forgets_to_close_puts_the_terminal_back(terminal: tuple[int, int]) -> None:
    before = termios.tcgetattr(terminal[1])
    code = (
        "import sys; from adapters.devices.keyboard.device import Keyboard\n"
        "device = Keyboard(tty=sys.argv[1]); raise RuntimeError('broken on purpose')"
    )
    command = [sys.executable, "-c", code, os.ttyname(terminal[1])]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "broken on purpose" in ended.stderr
    assert termios.tcgetattr(terminal[1]) == before


def test_a_terminal_that_is_closed_gives_no_keys_and_is_then_gone(opened: Open, terminal: tuple[int, int]) -> None:
    device = opened()
    typed(device, terminal, b"w")
    assert held(device) == {"w"}
    os.close(terminal[0])
    assert held(device) == set(), "never the last key"
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"the terminal was closed; run `station up` or `station serve keyboard`"):
            device.read()


@pytest.mark.parametrize(
    ("tty", "told"),
    [
        (
            "/dev/pts/none",
            "/dev/pts/none: cannot be opened: No such file or directory; run `station up` or `station serve keyboard`",
        ),
        ("/dev/null", "/dev/null: is no terminal; run `station up` or `station serve keyboard` in a terminal"),
    ],
)
def test_what_is_no_terminal_is_one_line(tty: str, told: str) -> None:
    with pytest.raises(DeviceError) as caught:
        Keyboard(tty=tty)
    assert str(caught.value).startswith(told)
    assert "\n" not in str(caught.value)


def test_two_never_share_the_keys_of_a_terminal(opened: Open, terminal: tuple[int, int]) -> None:
    first = opened()
    with pytest.raises(DeviceError, match=r"read by another keyboard server.*with tty one in which nothing else reads"):
        opened()
    typed(first, terminal, b"w")
    assert held(first) == {"w"}, "the first goes on"
    first.close()
    opened()


def test_a_keyboard_says_that_no_dead_man_may_hang_on_it(opened: Open) -> None:
    assert opened().facts()["tells_release"] is False


def test_a_script_types_the_same_bytes_every_time(clock: HandClock) -> None:
    steps = (TypistStep(at_s=0.1, press="up", for_s=0.6), TypistStep(at_s=0.65, text="Hi"),
             TypistStep(at_s=0.9, plugged=False), TypistStep(at_s=1.0, press="w"))  # fmt: skip

    def played(period_s: float) -> list[bytes | bool]:
        typing = Typing(Script(steps), clock)
        typing.begin()
        found = []
        for _ in range(round(2.0 / period_s)):
            clock.pass_(period_s)
            found += typing.due()
        return found

    up = b"\x1b[A"
    assert played(0.01) == played(0.25) == [up, up, up, b"Hi", up, up, False, b"w"]


def test_a_script_types_into_a_terminal_that_is_closed_and_opened_again(tmp_path: Path, clock: HandClock) -> None:
    file = tmp_path / "jog.json"
    steps = [{"at_s": 0.05, "press": "w"}, {"at_s": 0.3, "plugged": False}, {"at_s": 0.5, "plugged": True}]
    file.write_text(json.dumps({"device": "keyboard", "steps": steps}))
    terminal: FakeTerminal = install(file, clock)
    try:
        device = Keyboard(tty=str(terminal.path))
        terminal.begin()
        clock.pass_(0.1)
        wait_until(lambda: held(device) == {"w"})
        clock.pass_(0.25)
        ended: list[str] = []

        def is_gone() -> bool:
            try:
                device.read()
            except DeviceError as error:
                ended.append(str(error))
            return bool(ended)

        wait_until(is_gone)
        assert "the terminal was closed" in ended[0]
        clock.pass_(0.25)
        wait_until(terminal.path.exists)
        again = Keyboard(tty=str(terminal.path))
        assert held(again) == set()
        again.close()
    finally:
        terminal.close()


@pytest.mark.parametrize(
    ("step", "told"),
    [
        ({"at_s": 0, "press": "pu"}, "no key 'pu'"),
        ({"at_s": 0, "press": "escpe"}, "(did you mean 'escape'?)"),
        ({"at_s": 0, "press": "w", "for_s": -1}, "for_s is -1; expected 0 to 600 s"),
    ],
)
def test_a_bad_script_is_one_line(tmp_path: Path, step: dict[str, Any], told: str) -> None:
    file = tmp_path / "bad.json"
    file.write_text(json.dumps({"device": "keyboard", "steps": [step]}))
    with pytest.raises(BadFile) as caught:
        install(file)
    assert told in str(caught.value)
