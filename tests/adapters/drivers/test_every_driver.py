"""What holds for every driver, whatever drives it: no jump at engaging, in range, within rates, to rest when let go."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.drivers.body import BodyDriver
from adapters.drivers.hands import HandsDriver, HandsOptions
from station.operator.deadman import Snapshot
from station.operator.driver import Driver
from station.operator.sample import OperatorSample
from station.protocols import Floats

from .operators import DRIVERS, TICK_S, Operator, Shadow

pytest.importorskip("mink")


@pytest.fixture(params=DRIVERS)
def pair(request: pytest.FixtureRequest) -> tuple[Driver, Operator]:
    make, operator = DRIVERS[request.param]
    return make(), operator


class Wheel:
    """Engages and lets go, and holds every command against the one before it."""

    def __init__(self, driver: Driver, operator: Operator) -> None:
        self.driver, self.operator = driver, operator
        self.command: Floats = np.array(FORMAT.default)
        self.snapshot: Snapshot[object, object] | None = None
        self.time_s = 0.0

    def engage(self) -> None:
        self.snapshot = Snapshot(self.driver.inspect(self.reading()).input, self.driver.target)
        before = self.command
        self.tick()
        assert np.abs(self.command - before).max() <= 1e-6

    def let_go(self) -> None:
        self.snapshot = None

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.tick()

    def tick(self) -> None:
        self.time_s += TICK_S
        command = self.driver.step(self.reading(), self.snapshot, TICK_S)
        assert command.shape == FORMAT.default.shape
        assert (command >= FORMAT.lower).all()
        assert (command <= FORMAT.upper).all()
        assert (np.abs(command - self.command) <= FORMAT.rate * TICK_S + 1e-12).all()
        self.command = command

    def reading(self) -> OperatorSample:
        return self.operator(self.time_s)


def test_the_command_that_was_taken_up_stands_until_somebody_engages(pair: tuple[Driver, Operator]) -> None:
    wheel = Wheel(*pair)
    wheel.run(0.3)
    assert wheel.command == pytest.approx(FORMAT.default, abs=0.0)
    other = np.array(FORMAT.default)
    other[[2, 20, 23]] = 0.7, 0.2, 0.5
    wheel.driver.resume_from(other)
    wheel.command = other
    wheel.run(0.3)
    assert wheel.command == pytest.approx(other, abs=0.0)
    wheel.engage()
    assert wheel.command == pytest.approx(other, abs=0.0)


def test_engaging_and_letting_go_again_and_again_never_jumps(pair: tuple[Driver, Operator]) -> None:
    wheel = Wheel(*pair)
    wheel.run(0.05)
    for seconds in (1.5, 0.02, 0.3):
        wheel.engage()
        wheel.run(seconds)
        wheel.let_go()
        wheel.run(seconds / 2)


def test_engaged_it_moves_and_let_go_it_comes_to_rest(pair: tuple[Driver, Operator]) -> None:
    wheel = Wheel(*pair)
    wheel.engage()
    started = wheel.command
    wheel.run(2.0)
    assert np.abs(wheel.command - started).max() > 0.02
    wheel.let_go()
    wheel.run(4.0)
    assert wheel.driver.is_still
    resting = wheel.command
    wheel.run(0.5)
    assert wheel.command == pytest.approx(resting, abs=2e-3)
    assert wheel.command[[0, 1, 5]] == pytest.approx([0.0] * 3, abs=1e-2)


def test_silence_is_survived(pair: tuple[Driver, Operator]) -> None:
    wheel = Wheel(*pair)
    wheel.engage()
    wheel.run(0.5)
    wheel.let_go()
    for _ in range(20):
        wheel.command = wheel.driver.step(None, None, TICK_S)
    assert np.isfinite(wheel.command).all()


def test_a_sample_without_what_it_needs_is_none(pair: tuple[Driver, Operator]) -> None:
    driver, operator = pair
    assert driver.inspect(operator(0.0)).why_not == ""
    look = driver.inspect(OperatorSample())
    assert look.input is None
    assert look.why_not
    assert "\n" not in look.why_not


def test_what_stands_beside_the_command_is_as_long_as_stock_readers_expect(pair: tuple[Driver, Operator]) -> None:
    driver, operator = pair
    driver.step(operator(0.0), None, TICK_S)
    sizes = {key: len(values) for key, values in driver.auxiliary.items()}
    assert sizes == {key: len(values) for key, values in FORMAT.auxiliary.items()}


def test_its_facts_name_it(pair: tuple[Driver, Operator]) -> None:
    assert pair[0].facts()["driver"] == pair[0].name
    assert pair[0].command_format is FORMAT


@pytest.mark.parametrize(
    "driver",
    [
        HandsDriver(HandsOptions(robot="g1_29_track")),
        BodyDriver(Shadow(), robot="g1_29_track"),
    ],
    ids=lambda driver: driver.name,
)
def test_a_part_that_takes_motions_is_driven_under_its_own_key(driver: Driver) -> None:
    assert driver.command_format.key == "action_motion_g1_29_track"
    assert driver.command_format.elements == FORMAT.elements
    assert driver.auxiliary == {}, "hands and neck are those of the robot that stock programs know"
