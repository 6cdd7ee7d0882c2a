"""Whatever arrives when, by whatever stamp: nothing that is too old by either clock moves a joint. In virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from adapters.commands.body import BodyCommand
from station.bus import codec, stamp
from station.bus.clocks import Offset
from station.bus.hearing import HeardSpan
from station.bus.sample import Sample
from station.clock import SYSTEM
from station.contract import elements
from station.control.arming import Arming
from station.control.command_arbiter import CommandArbiter
from station.control.command_path import CommandPath
from station.control.command_receiver import Arrival, CommandReceiver, CommandWatch, NewWrites, writer_of
from station.control.gate import Decision, GateConfig
from station.protocols import Floats, StockKeys
from tests.examples import examples

DT_NS = 20_000_000
START_NS = 5_000_000_000_000
HOLD_NS, LIMIT_NS, SLACK_NS = 100_000_002, 250_000_002, 20_000_002  # and two nanoseconds of rounding
ROUNDING = 1e-9
HERE = stamp.boot_id()
KEY = "action_tiny"
ENDS = np.array([2.0, 1.0, 3.0])
FORMAT = BodyCommand(
    name="tiny", robot="tiny", key=KEY, note="", auxiliary={}, stock=StockKeys(), default=np.zeros(3),
    lower=-ENDS, upper=ENDS, margin=np.ones(3), rate=np.array([30.0, 3.0, 20.0]), velocities=(0,),
    joint_names=("joint",), head=lambda _: [],
    elements=elements((("root_vel_x",), "m/s"), (("root_height",), "m"), (("joint_pos",), "rad")),
)  # fmt: skip
"""A velocity, a height and a joint: what the gate treats differently, and no more to compute."""


class VirtualWatch:
    """What a `CommandWatch` is to a receiver: writes are delivered by the test, at instants that it says."""

    doubtful, clock = 0, SYSTEM

    def __init__(self) -> None:
        self._slot: Sample | None = None
        self._arrivals: list[Arrival] = []
        self._newest: dict[str, Sample] = {}
        self.now_ns = START_NS

    def deliver(self, value: Floats, mark: stamp.Stamp | None, clock: Offset | None = None) -> Sample:
        sample = self._slot = Sample(KEY, codec.json_vector(value), mark, self.now_ns, clock)
        self._arrivals.append(Arrival(writer_of(sample), self.now_ns, is_clear=True))
        self._newest[writer_of(sample)] = sample
        return sample

    def latest(self, key: str) -> Sample | None:
        return self._slot

    def pop(self) -> NewWrites:
        taken = NewWrites(HeardSpan(START_NS, self.now_ns), self._arrivals, self._newest)
        self._arrivals, self._newest = [], {}
        return taken


class Robot:
    """The way of a command from the watch to what the policy gets, tick by tick."""

    def __init__(self, config: GateConfig | None = None) -> None:
        config = config or GateConfig()
        self.watch = VirtualWatch()
        self.receiver = CommandReceiver(
            cast(CommandWatch, self.watch), KEY, CommandArbiter(config.rivals, config.return_after_s)
        )
        self.commanded = CommandPath(FORMAT, config, Arming(is_armed=True))
        self.seq = 0

    @property
    def now_s(self) -> float:
        return self.watch.now_ns * 1e-9

    def write(self, vector: Floats, ago_s: float = 0.0, boot: str = HERE, clock: Offset | None = None) -> Sample:
        self.seq += 1
        mono_ns = self.watch.now_ns - round(ago_s * 1e9) - (clock.ns if clock else 0)
        return self.watch.deliver(vector, stamp.Stamp(self.seq, mono_ns, 0, f"motion.1.{boot}.n"), clock)

    def tick(self) -> Decision:
        self.watch.now_ns += DT_NS
        self.commanded.heard_all(*self.receiver.heard_s)
        return self.commanded.decide(self.receiver.newest(), self.now_s)

    def follow(self, vector: Floats, ticks: int = 60, **stamped: object) -> Decision:
        for _ in range(ticks):
            self.write(vector, **stamped)  # type: ignore[arg-type]
            decision = self.tick()
        return decision

    def told(self, *names: str) -> list[str]:
        return [step_event.name for step_event in self.commanded.taken() if step_event.name in names]


def test_a_burst_of_old_commands_moves_nothing_is_counted_and_is_told_when_it_begins_and_ends() -> None:
    robot = Robot()
    assert robot.follow(ENDS / 2).state == "tracking"
    for _ in range(150):  # the line is frozen for three seconds
        frozen = robot.tick()
    assert frozen.state == "waiting"
    robot.commanded.taken()
    for ago_s in np.arange(3.0, 0.26, -0.2):  # and delivers them within a few ticks
        robot.write(ENDS, ago_s=ago_s)
        decision = robot.tick()
        assert decision.state == "waiting"
        np.testing.assert_array_equal(decision.vector, FORMAT.default)
    assert decision.reason.startswith("stale: written 0.")
    assert robot.commanded.validator.refused == {"stale": 14}
    assert robot.told("refused-command", "command-good-again") == ["refused-command"]
    assert robot.follow(ENDS / 2, ticks=1).state == "entering"
    assert robot.told("refused-command", "command-good-again") == ["command-good-again"]


def test_one_old_command_among_fresh_ones_leaves_the_fresh_one_followed() -> None:
    robot = Robot()
    robot.follow(ENDS / 2)
    robot.write(-ENDS, ago_s=1.0)
    decision = robot.tick()
    assert decision.state == "tracking"
    np.testing.assert_array_equal(decision.vector, ENDS / 2)


def test_a_command_that_came_late_but_in_time_is_followed_until_it_is_250_ms_old() -> None:
    robot = Robot()
    assert robot.follow(ENDS / 2, ago_s=0.19).state == "tracking"
    states = [robot.tick().state for _ in range(3)]
    assert states == ["tracking", "tracking", "holding"], "230, 250 and 270 ms after it was written"


@pytest.mark.parametrize("boot", ["00000000", ""])
def test_a_writer_on_another_machine_is_followed_by_arrival_whatever_its_clock_says(boot: str) -> None:
    assert Robot().follow(ENDS / 2, ago_s=1e6, boot=boot).state == "tracking"
    assert Robot().follow(ENDS / 2, ago_s=-1e6, boot=boot).state == "tracking"


FAR = {"boot": "eeeeeeee", "clock": Offset(ns=-7_000_000_000_000, error_ns=5_000_000)}
"""A writer on another machine that was switched on two hours before ours, and whose clock is known to 5 ms."""


def test_of_a_machine_whose_clock_is_known_an_old_command_is_refused_and_a_fresh_one_followed() -> None:
    robot = Robot()
    assert robot.follow(ENDS / 2, ago_s=0.03, **FAR).state == "tracking"
    written_ns = robot.watch.now_ns - DT_NS - 30_000_000
    assert (sample := robot.commanded.validator.good) is not None
    assert sample.written_ns == written_ns, "on our clock: what an episode keeps, and its audit computes with"
    robot.write(-ENDS, ago_s=0.3, **FAR)
    decision = robot.tick()
    assert robot.commanded.validator.refused == {"stale": 1}
    np.testing.assert_array_equal(decision.vector, ENDS / 2)


def test_what_seems_to_come_from_the_future_by_less_than_its_clock_may_be_wrong_was_written_as_it_came() -> None:
    robot = Robot()
    assert robot.follow(ENDS / 2, ago_s=-0.004, **FAR).state == "tracking"
    assert (sample := robot.commanded.validator.good) is not None
    assert (sample.delay_s, sample.written_ns) == (0.0, sample.arrived_ns)
    assert Robot().follow(ENDS / 2, ago_s=-0.05, **FAR).state == "waiting", "by more than that it is a lie"


def test_a_stamp_from_the_future_is_none_of_this_machines_clock_and_refused() -> None:
    robot = Robot()
    assert robot.follow(ENDS / 2, ago_s=-5.0).state == "waiting"
    assert robot.commanded.validator.refused == {"wrong-clock": 60}


def test_who_holds_longer_takes_commands_as_old() -> None:
    robot = Robot(GateConfig(hold_after_s=1.0, return_after_s=2.0))
    assert robot.follow(ENDS / 2, ago_s=0.9).state == "tracking"


def test_in_lock_step_no_time_of_a_writer_counts() -> None:
    robot = Robot()
    for tick in range(60):
        robot.write(ENDS / 2, ago_s=30.0)
        robot.watch.now_ns += DT_NS
        decision = robot.commanded.decide(robot.receiver.newest(tick * 0.02), tick * 0.02)
    assert decision.state == "tracking"


# -- any delivery at all -----------------------------------------------------------------------------------------

ERROR_NS = 5_000_000
LIES = (0, -1, -(10**30), 10**30, 2**63, -(2**63), START_NS + 10**10, 10**400)
_ago_s = st.one_of(st.floats(0.0, 0.3), st.floats(0.0, 4.0), st.sampled_from([0.0, 0.15, 0.2499, 0.2501, 2.0]))
_messages = st.tuples(
    st.integers(0, 70),  # the tick that it is delivered in: in any order, many in one, the same more than once
    st.sampled_from(["one", "one", "one", "two", "elsewhere", "far", "far", "foreign"]),
    st.one_of(_ago_s, _ago_s, st.sampled_from(LIES)),
    st.sampled_from([1.0, -1.0, 0.5]),
)
_steady = st.tuples(st.integers(0, 50), st.integers(1, 70), st.sampled_from([0.0, 0.01, 0.08, 0.2, 0.3, 2.0]))


def deliveries(
    steady: list[tuple[int, int, float]], messages: list[tuple[int, str, float | int, float]]
) -> Iterator[tuple[int, str, float | int, float]]:
    """Streams of one writer, each with a delay of its own, and single messages of anybody among them."""
    for start, ticks, ago_s in steady:
        yield from ((tick, "one", ago_s, 1.0) for tick in range(start, start + ticks))
    yield from messages


def within(vector: Floats, among: list[Floats]) -> bool:
    lower, upper = np.min(among, axis=0) - ROUNDING, np.max(among, axis=0) + ROUNDING
    return bool(((vector >= lower) & (vector <= upper)).all())


def expect_nothing_stale_moves(
    steady: list[tuple[int, int, float]], messages: list[tuple[int, str, float | int, float]]
) -> None:
    """Play deliveries and judge every tick by what was delivered, not by what the gate says of it.

    In a tick for which some command is in time, no element leaves the span of where it was, where its blend began and
    the commands that are in time; in any other tick, it comes no farther from standing. What another machine wrote is
    in time while it may be, by the error of its clock; by how much that is wrong changes with every command.
    """
    robot, came = Robot(), list[tuple[int, int, Floats]]()  # arrival and delay [ns], command
    by_tick: dict[int, list[tuple[str, float | int, float]]] = {}
    for tick, *message in deliveries(steady, messages):
        by_tick.setdefault(tick, []).append(tuple(message))  # type: ignore[arg-type]
    before = start = FORMAT.default
    for tick in range(100):
        for who, ago, sign in by_tick.get(tick, ()):
            number = len(came) + 1
            vector, now_ns = sign * ENDS * (0.2 + 0.8 / number), robot.watch.now_ns
            mono_ns = ago if isinstance(ago, int) else now_ns - round(ago * 1e9)
            boot = {"elsewhere": "ffffffff", "far": "eeeeeeee"}.get(who, HERE)
            mark = None if who == "foreign" else stamp.Stamp(number, mono_ns, 0, f"{who}.1.{boot}.n")
            wrong_by_ns = (number * 7 % 11 - 5) * ERROR_NS // 5
            robot.watch.deliver(vector, mark, Offset(wrong_by_ns, ERROR_NS) if who == "far" else None)
            delay_ns = now_ns - mono_ns if who in ("one", "two", "far") else 0
            came.append((now_ns, delay_ns - ERROR_NS if who == "far" else delay_ns, vector))
        decision = robot.tick()
        now_ns = robot.watch.now_ns
        usable = [
            vector
            for arrived_ns, delay_ns, vector in came
            if (age_ns := now_ns - arrived_ns) <= HOLD_NS and delay_ns >= -SLACK_NS and age_ns + delay_ns <= LIMIT_NS
        ]
        if any(change.after in ("entering", "tracking") for change in decision.transitions):
            start = before
        if usable:
            event("some command in time")
            assert within(decision.vector, [before, start, FORMAT.default, *usable])
        else:
            assert decision.state not in ("entering", "tracking")
            assert (np.abs(decision.vector) <= np.abs(before) + ROUNDING).all()
        before = decision.vector


SCENES = (st.lists(_steady, max_size=3), st.lists(_messages, max_size=30))


@settings(max_examples=examples(400), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(*SCENES)
def test_nothing_stale_moves_a_joint(
    steady: list[tuple[int, int, float]], messages: list[tuple[int, str, float | int, float]]
) -> None:
    expect_nothing_stale_moves(steady, messages)
