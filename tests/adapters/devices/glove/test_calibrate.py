"""Calibrating a glove with a person who does, in the end, what is asked."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from adapters.devices.glove.calibrate import Plan, calibrate_port
from adapters.devices.glove.calibration import load
from adapters.devices.glove.sensors import FINGERS, PRESETS
from station.operator.device import DeviceError
from tests.adapters.devices.glove.serial_line import Line, lines_in_memory
from tests.virtual.clock import VirtualClock

PERIOD_S = 0.01


class Person:
    """Wears a glove that writes a hundred lines per second."""

    def __init__(self, clock: VirtualClock, folder: Path, lines: dict[str, Line]) -> None:
        self.clock, self.line = clock, Line(clock, folder, "GL1")
        lines[str(self.line.path)] = self.line
        self.count, self.closed, self.is_careless = 5, 0.4, False
        self.said, self.asked = list[str](), list[str]()
        self.write: Callable[[], bytes] = self.numbers
        self.stuck = dict[int, float]()
        self._stop, self._lines = threading.Event(), 0
        self._thread = clock.start(self._run, "glove")

    def show(self, line: str) -> None:
        self.said.append(line)

    def ask(self, question: str) -> str:
        self.asked.append(question)
        if question.startswith("Make a fist"):
            self.closed, self.is_careless = (0.01, False) if self.is_careless else (1.0, False)
        else:
            self.closed = 0.0
        return ""

    def shown(self) -> list[float]:
        """What each sensor shows: it rises on one and falls on the next; with some noise."""
        noise = (self._lines % 3 - 1) * 2
        ends = [(500 + number, 2500) if number % 2 else (3000, 900 - number) for number in range(self.count)]
        shown = [opened + self.closed * (closed - opened) + noise for opened, closed in ends]
        return [self.stuck.get(number, count) for number, count in enumerate(shown)]

    def numbers(self) -> bytes:
        return " ".join(str(round(count)) for count in self.shown()).encode() + b"\r\n"

    def decimals(self) -> bytes:
        return ",".join(f"{count / 1000:.4f}" for count in self.shown()).encode() + b"\n"

    def letters(self) -> bytes:
        return (
            "".join(f"{key}{round(count)}" for key, count in zip("ABCDE", self.shown(), strict=True)).encode() + b"\n"
        )

    def calibrate(self, plan: Plan, folder: Path) -> Path:
        return calibrate_port(str(self.line.path), plan, self, folder=folder, clock=self.clock)

    def close(self) -> None:
        self._stop.set()
        self.clock.join(self._thread)

    def _run(self) -> None:
        while not self.clock.wait(self._stop, PERIOD_S):
            self._lines += 1
            self.line.send(self.write())


@pytest.fixture
def person(tmp_path: Path) -> Iterator[Person]:
    with VirtualClock() as clock, lines_in_memory() as lines:
        made = Person(clock, tmp_path, lines)
        yield made
        made.close()


def test_a_flat_hand_and_a_fist_are_found_and_kept_by_serial_and_side(person: Person, tmp_path: Path) -> None:
    file = person.calibrate(Plan("left"), tmp_path / "kept")
    assert file == tmp_path / "kept" / "GL1-left.yaml"
    made = load(tmp_path / "kept", "GL1", "left")
    assert made.names == FINGERS
    assert (made.protocol, made.numbers) == ("numbers", 5)
    assert [(sensor.open, sensor.closed) for sensor in made.sensors] == [
        (3000, 900), (501, 2500), (3000, 898), (503, 2500), (3000, 896),
    ]  # fmt: skip
    assert [question.split(",")[0] for question in person.asked] == ["Hold the hand flat", "Make a fist"]
    assert person.said[0] == "a line has 5 numbers: thumb, index, middle, ring, little"
    assert person.said[-1] == f"glove GL1 is calibrated for the left hand: {file}"
    assert person.line.users == 0, "the port was let go of"


def test_fifteen_numbers_are_three_for_each_finger(person: Person, tmp_path: Path) -> None:
    person.count = 15
    person.calibrate(Plan("right"), tmp_path)
    assert load(tmp_path, "GL1", "right").names == PRESETS[15]


def test_numbers_of_other_lines_are_named_and_some_left_out(person: Person, tmp_path: Path) -> None:
    person.count = 4
    with pytest.raises(DeviceError, match="a line has 4 numbers, and only 5 and 15 have names by themselves"):
        person.calibrate(Plan("left"), tmp_path)
    with pytest.raises(DeviceError, match="a line has 4 numbers, but --sensors names 2: thumb,index"):
        person.calibrate(Plan("left", sensors=("thumb", "index")), tmp_path)
    assert not list(tmp_path.glob("*.yaml"))
    person.stuck = {1: 77.0}
    person.calibrate(Plan("left", sensors=("thumb_rotation", "-", "index_0", "index_1")), tmp_path)
    made = load(tmp_path, "GL1", "left")
    assert made.names == ("thumb_rotation", "index_0", "index_1")
    assert [sensor.number for sensor in made.sensors] == [0, 2, 3]


def test_letters_are_the_five_fingers(person: Person, tmp_path: Path) -> None:
    person.write = person.letters
    person.calibrate(Plan("left", "opengloves"), tmp_path)
    made = load(tmp_path, "GL1", "left")
    assert (made.protocol, made.names) == ("opengloves", FINGERS)


def test_what_was_not_closed_is_asked_again(person: Person, tmp_path: Path) -> None:
    person.is_careless = True
    person.calibrate(Plan("left"), tmp_path)
    assert len(person.asked) == 4
    assert load(tmp_path, "GL1", "left").sensors[1].closed == 2500


@pytest.mark.parametrize(
    ("shown", "told"),
    [
        (77.0, "ring: number 4 of the line has moved by 0 only, expected 146.2 at least; see to its magnet or lever"),
        (None, "ring: number 4 of the line has moved by 100 only, expected 125 at least"),
    ],
)
def test_a_sensor_that_does_not_move_is_named(person: Person, tmp_path: Path, shown: float | None, told: str) -> None:
    asked = person.ask

    def ask(question: str) -> str:
        person.stuck = {3: shown if shown is not None else 500.0 + 100.0 * question.startswith("Make a fist")}
        if len(person.asked) == 2:
            raise KeyboardInterrupt
        return asked(question)

    person.ask = ask
    with pytest.raises(KeyboardInterrupt):
        person.calibrate(Plan("left"), tmp_path)
    assert (
        [line for line in person.said if "has moved by" in line] == [line for line in person.said if told in line] != []
    )
    assert not list(tmp_path.glob("*.yaml"))


def test_ten_counts_are_the_least_for_whole_numbers_and_noise_for_any(person: Person, tmp_path: Path) -> None:
    person.write = person.decimals
    person.calibrate(Plan("left"), tmp_path)
    assert load(tmp_path, "GL1", "left").sensors[0].closed == pytest.approx(0.9)
    person.asked.clear()
    person.write = lambda: " ".join(str(round(count / 400)) for count in person.shown()).encode() + b"\n"
    asked = person.ask

    def ask(question: str) -> str:
        if len(person.asked) == 2:
            raise KeyboardInterrupt
        return asked(question)

    person.ask = ask
    with pytest.raises(KeyboardInterrupt):
        person.calibrate(Plan("left"), tmp_path)
    assert any("thumb: number 1 of the line has moved by 6 only, expected 10 at least" in line for line in person.said)


@pytest.mark.parametrize(
    ("write", "told"),
    [
        (b"", "no glove writes here at 115200 baud: nothing comes; see to its power and cable"),
        (b"12 ", "no whole line, expected numbers with spaces or commas between, and the end of a line; see to --baud"),
        (b"A1B2\n", "the last bad line is 'A1B2', expected numbers with spaces or commas between; see to --baud and"),
    ],
)
def test_where_no_glove_writes_it_is_told_what_came(person: Person, tmp_path: Path, write: bytes, told: str) -> None:
    person.write = lambda: write
    with pytest.raises(DeviceError) as caught:
        person.calibrate(Plan("left"), tmp_path)
    assert told in str(caught.value)
    assert not person.asked


def test_a_glove_that_writes_too_seldom_is_refused(person: Person, tmp_path: Path) -> None:
    person.write = lambda: person.numbers() if person._lines % 20 == 0 else b""
    with pytest.raises(DeviceError, match=r"3 lines in 0.5 s, expected 5 at least; let it write more often"):
        person.calibrate(Plan("left"), tmp_path)


def test_a_glove_that_is_torn_out_meanwhile_is_told(person: Person, tmp_path: Path) -> None:
    ask = person.ask
    person.ask = lambda question: (person.line.unplug(), ask(question))[1]
    with pytest.raises(DeviceError, match=r"gone .*plug the glove in again"):
        person.calibrate(Plan("left"), tmp_path)
