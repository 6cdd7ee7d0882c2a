"""A robot whose legs, arms and hands are commanded apart: each part depends on its own command alone, whatever becomes
of the others. A pedal that falls silent stops the walk, and the arms stay where they are asked to be."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.arms import JointCommand
from station.bus import codec
from station.contract import Element, elements
from station.control.arming import Arming
from station.control.command_path import CommandPath
from station.control.command_validator import CommandSample
from station.control.control import ControlStep, StepRecord
from station.control.gate import Decision, GateConfig
from station.control.parted_path import PartedPath
from station.errors import ConfigError
from station.parts import PartedCommand
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState, StockKeys
from tests.control.ideal_robot import IdealRobot
from tests.control.parted_walk import HOLOSOMA, walked

DT = 0.02
LEGS, ARMS, HANDS = ("hip", "knee"), ("shoulder", "elbow"), ("grip",)


@dataclass(frozen=True, eq=False)
class Walk:
    """The command of legs: forward [m/s], turning left [rad/s]."""

    name: str = "walk"
    robot: str = "cart_legs"
    key: str = "action_velocity_cart_legs"
    elements: tuple[Element, ...] = elements((("vx",), "m/s"), (("wz",), "rad/s"))
    note: str = ""
    auxiliary: dict[str, Floats] = field(default_factory=dict)
    stock: StockKeys = field(default_factory=StockKeys)
    holds_position: bool = False
    velocities: tuple[int, ...] = (0, 1)
    default: Floats = field(default_factory=lambda: np.zeros(2))
    lower: Floats = field(default_factory=lambda: np.array([-0.5, -1.0]))
    upper: Floats = field(default_factory=lambda: np.array([0.5, 1.0]))
    margin: Floats = field(default_factory=lambda: np.ones(2))
    rate: Floats = field(default_factory=lambda: np.array([2.0, 4.0]))


def joints(part: str, names: tuple[str, ...]) -> JointCommand:
    size = len(names)
    return JointCommand.within(
        part, f"cart_{part}", names, lower=np.full(size, -2.0), upper=np.full(size, 2.0), margin=np.full(size, 0.1),
        rate=np.full(size, 1.0),
    )  # fmt: skip


PARTS = (Walk(), joints("arms", ARMS), joints("hands", HANDS))
FORMAT = PartedCommand("cart", "cart", PARTS)
SIZES = (2, 2, 1)


# -- Each part depends on its own command alone --------------------------------------------------------------------
@st.composite
def histories(draw: st.DrawFn) -> list[tuple[CommandSample | None, ...]]:
    """What the three keys hold in each tick: fresh, old, none, wrong, too far, by another writer."""
    ticks = draw(st.integers(1, 120))
    held: list[list[CommandSample | None]] = []
    for size in SIZES:
        newest: CommandSample | None = None
        column = []
        while len(column) < ticks:
            kind = draw(st.sampled_from(["fresh", "fresh", "fresh", "silent", "bad", "far", "other"]))
            for _ in range(draw(st.integers(1, 30))):
                now_s = DT * (len(column) + 1)
                if kind != "silent":
                    value = draw(st.floats(-0.4, 0.4)) * (100.0 if kind == "far" else 1.0)
                    data = b"odd" if kind == "bad" else codec.json_vector(np.full(size, value))
                    newest = CommandSample(data, now_s, source="b.1.x.n" if kind == "other" else "a.1.x.n")
                column.append(newest)
        held.append(column[:ticks])
    return list(zip(*held, strict=True))


def same(one: Decision, other: Decision) -> bool:
    return (one.state, one.reason, one.limited, one.vector.tobytes()) == (
        other.state, other.reason, other.limited, other.vector.tobytes(),
    )  # fmt: skip


@given(histories(), st.integers(0, 200))
def test_what_a_part_is_let_through_is_what_its_own_gate_alone_would_have_given(
    history: Sequence[tuple[CommandSample | None, ...]], stopped_at: int
) -> None:
    together = PartedPath(FORMAT, GateConfig(), Arming(is_armed=True))
    alone = [CommandPath(part, GateConfig(), Arming(is_armed=True)) for part in PARTS]
    for tick, samples in enumerate(history):
        now_s = DT * (tick + 1)
        if tick == stopped_at:
            for path in (together, *alone):
                path.stop("test")
        decision = together.decide(samples, now_s)
        for part, path, sample in zip(decision.parts, alone, samples, strict=True):
            assert same(part, path.decide(sample, now_s))
        np.testing.assert_array_equal(decision.vector, np.concatenate([part.vector for part in decision.parts]))
        assert (decision.state == "stopped") == (tick >= stopped_at)


# -- On a robot ----------------------------------------------------------------------------------------------------
class Cart(IdealRobot):
    """Wheels under two arms' joints and a hand's; the legs are its policy's."""

    joint_names = (*LEGS, *ARMS, *HANDS)

    def __init__(self) -> None:
        super().__init__()
        self.q = np.array([0.1, 0.2, 0.3, 0.4, 0.5])

    def read(self) -> RobotState:
        return RobotState(1, self.q.copy(), np.zeros(5), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))


class Roll:
    """A policy that puts the legs where the velocities say, and the rest where its command says.

    Args:
        adds: To what each joint is told [rad], as one that balances with its arms does.
    """

    def __init__(self, adds: float = 0.0) -> None:
        self._adds = adds
        self.spec = PolicySpec(
            name="roll", checkpoint=Path("none"), sha256="", runtime="none", rate_hz=50.0, command="cart",
            joint_names=Cart.joint_names, default_q=np.zeros(5), kp=np.full(5, 50.0), kd=np.full(5, 2.0),
            observation_size=5, action_size=5,
        )  # fmt: skip

    def reset(self) -> None:
        """There is no history."""

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        return command.astype(np.float32)

    def act(self, observation: Floats32) -> Floats32:
        return observation

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        return JointTargets(command + self._adds, self.spec.kp, self.spec.kd)

    def restore(self, observation: Floats32) -> None:
        """There is no history."""


class Bench:
    def __init__(self, *, is_armed: bool = True, adds: float = 0.0) -> None:
        self.cart = Cart()
        self.control = ControlStep(self.cart, Roll(adds), FORMAT, is_armed=is_armed)
        self.tick = 0
        self.held: list[CommandSample | None] = [None, None, None]

    def step(self, *vectors: Sequence[float] | None) -> StepRecord:
        """Step; None is silence of a part."""
        self.tick += 1
        for index, vector in enumerate(vectors):
            if vector is not None:
                self.held[index] = CommandSample(codec.json_vector(vector), arrived_s=self.tick * DT)
        return self.control.step(self.control.sense(), tuple(self.held), self.tick * DT)

    def steps(self, count: int, *vectors: Sequence[float] | None) -> StepRecord:
        return [self.step(*vectors) for _ in range(count)][-1]


def states(record: StepRecord) -> list[str]:
    return [part.state for part in record.decision.parts]


def test_a_silent_pedal_stops_the_walk_and_the_arms_and_hands_are_followed_on() -> None:
    bench = Bench()
    record = bench.steps(100, [0.4, 0.2], [1.0, 0.5], [0.2])
    assert (states(record), record.decision.state) == (["tracking"] * 3, "tracking")
    np.testing.assert_allclose(record.sent.q, [0.4, 0.2, 1.0, 0.5, 0.2])
    asked = np.array([bench.step(None, [1.0 + 0.01 * tick, 0.5], [0.2]).sent.q for tick in range(30)])
    assert asked[15:, :2].tolist() == [[0.0, 0.0]] * 15, (
        "0.3 s after the last word of the pedal the velocities are zero"
    )
    np.testing.assert_allclose(asked[-1, 2:], [1.29, 0.5, 0.2])
    record = bench.step(None, [1.29, 0.5], [0.2])
    assert states(record)[1:] == ["tracking", "tracking"]
    assert record.decision.state == "tracking"


def test_silent_arms_stay_where_they_were_asked_to_be_and_the_walk_goes_on() -> None:
    bench = Bench()
    bench.steps(100, [0.4, 0.2], [1.0, 0.5], [0.2])
    record = bench.steps(200, [0.4, 0.2], None, [0.2])
    assert states(record) == ["tracking", "waiting", "tracking"]
    np.testing.assert_allclose(record.sent.q, [0.4, 0.2, 1.0, 0.5, 0.2])


def test_what_a_policy_adds_to_arms_does_not_carry_off_arms_that_rest() -> None:
    bench = Bench(adds=0.05)
    record = bench.steps(100, [0.4, 0.2], [1.0, 0.5], None)
    np.testing.assert_allclose(record.sent.q, [0.45, 0.25, 1.05, 0.55, 0.55])
    record = bench.steps(200, [0.4, 0.2], None, None)
    assert states(record) == ["tracking", "waiting", "waiting"]
    np.testing.assert_allclose(record.sent.q, [0.45, 0.25, 1.05, 0.55, 0.55])


def test_parts_that_nobody_has_commanded_rest_where_they_are() -> None:
    record = Bench().steps(100, [0.4, 0.0])
    np.testing.assert_allclose(record.sent.q, [0.4, 0.0, 0.3, 0.4, 0.5])


def test_arms_are_followed_before_anybody_has_touched_the_pedal() -> None:
    record = Bench().steps(100, None, [1.0, 0.5], None)
    assert states(record) == ["waiting", "tracking", "waiting"]
    np.testing.assert_allclose(record.sent.q, [0.0, 0.0, 1.0, 0.5, 0.5])


def test_a_stop_is_all_of_the_robot_s_and_after_its_release_each_part_has_to_begin_anew() -> None:
    bench, commands = Bench(), ([0.4, 0.2], [1.0, 0.5], [0.2])
    bench.steps(100, *commands)
    bench.control.stop("by hand")
    record = bench.step(*commands)
    assert states(record) == ["stopped"] * 3
    assert not record.sent.kp.any()
    bench.control.reset("released")
    assert bench.control.arm(bench.tick * DT) == ""
    record = bench.steps(200, *commands)
    assert states(record) == ["waiting"] * 3
    bench.steps(20, None, commands[1], commands[2])
    assert states(bench.steps(100, *commands)) == ["tracking", "waiting", "waiting"], (
        "the pedal let go, the others never"
    )


def test_a_pedal_that_is_down_while_the_robot_is_armed_moves_nothing_before_it_was_let_go() -> None:
    bench, commands = Bench(is_armed=False), ([0.4, 0.2], [1.0, 0.5], [0.2])
    bench.steps(50, *commands)
    assert bench.control.arm(bench.tick * DT) == ""
    record = bench.steps(200, *commands)
    assert bench.control.arming.state == "armed"
    assert states(record) == ["waiting"] * 3
    np.testing.assert_allclose(record.sent.q, [0.0, 0.0, 0.3, 0.4, 0.5])
    bench.steps(20)
    assert states(bench.steps(100, *commands)) == ["tracking"] * 3


def test_a_part_that_does_not_say_where_it_is_leaves_the_robot_limp_and_comes_back_when_it_does() -> None:
    bench = Bench()
    bench.cart.q[3] = math.nan
    record = bench.steps(5, [0.4, 0.2], [1.0, 0.5], [0.2])
    assert not record.sent.kp.any()
    assert np.isfinite(record.decision.vector).all()
    bench.cart.q[3] = 0.4
    bench.steps(20)
    record = bench.steps(150, [0.4, 0.2], [1.0, 0.5], [0.2])
    assert states(record) == ["tracking"] * 3
    np.testing.assert_allclose(record.sent.q, [0.4, 0.2, 1.0, 0.5, 0.2])


def test_what_happens_to_a_part_is_told_with_its_name_and_the_stop_once() -> None:
    bench = Bench()
    told = [step_event for _ in range(100) for step_event in bench.step([0.4, 0.2], None, None).step_events]
    assert {step_event.detail["part"] for step_event in told if step_event.name == "gate"} == {"legs"}
    bench.control.stop("by hand")
    stops = [step_event for step_event in bench.step().step_events if step_event.name == "estop"]
    assert [step_event.detail for step_event in stops] == [{"reason": "by hand"}]


def test_the_gate_tells_of_the_robot_and_of_each_part() -> None:
    bench = Bench()
    record = bench.steps(100, [0.4, 0.2], None, None)
    told = bench.control.commanded.status(record.decision)
    assert (told["state"], told["arming"], told["refused"]) == ("tracking", "armed", 0)
    assert {name: part["state"] for name, part in told["parts"].items()} == {
        "legs": "tracking", "arms": "waiting", "hands": "waiting",
    }  # fmt: skip
    assert math.isclose(told["age_s"], 0.0, abs_tol=1e-9)


@pytest.mark.parametrize(
    ("parts", "line"),
    [
        ((PARTS[1], joints("legs", (ARMS[0],))), "shoulder_pos: in more than one part"),
        ((PARTS[0],), "expected two parts or more, each with a key and a name of its own, cart_PART; got cart_legs"),
        ((PARTS[0], joints("x", HANDS)), ""),
        ((joints("arms", ARMS), joints("arms", HANDS)), "each with a key and a name of its own"),
    ],
)
def test_parts_that_do_not_fit_together_are_refused_in_a_line(parts: tuple[JointCommand, ...], line: str) -> None:
    if not line:
        other = JointCommand.within("hand", "wagon_hand", HANDS, lower=-np.ones(1), upper=np.ones(1), margin=np.ones(1),
                                    rate=np.ones(1))  # fmt: skip
        parts, line = (parts[0], other), "got cart_legs, wagon_hand"
    with pytest.raises(ConfigError, match=line):
        PartedCommand("cart", "cart", parts)


def test_the_whole_has_the_numbers_of_its_parts_in_their_order() -> None:
    assert [element.name for element in FORMAT.elements] == [
        "vx", "wz", *(f"{joint}_pos" for joint in itertools.chain(ARMS, HANDS)),
    ]  # fmt: skip
    assert (FORMAT.velocities, len(FORMAT.default), FORMAT.upper.tolist()) == ((0, 1), 5, [0.5, 1.0, 2.0, 2.0, 2.0])
    assert [part.tolist() for part in FORMAT.split(np.arange(5.0))] == [[0.0, 1.0], [2.0, 3.0], [4.0]]


# -- On a simulated G1 ---------------------------------------------------------------------------------------------
@pytest.mark.assets
def test_a_g1_walks_on_while_pedals_and_arms_come_and_go_each_as_its_own_gate_alone_would_have_it(assets: Path) -> None:
    """Ten minutes of it, and more arm: `test_proof_parts.py`."""
    ways = [place for _, place in walked("holosoma", HOLOSOMA, 0.5, 20.0)]
    assert ways[-1] is not None
    assert ways[0] is not None
    assert np.linalg.norm(ways[-1][:2] - ways[0][:2]) > 0.3
