"""A hand as the station drives it, tried on the hands of a robot's twin, in simulated time through Cyclone itself."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.commands import hands as commands
from adapters.commands.hand import HandCommand
from adapters.policies.direct import DirectPolicy
from adapters.robots.g1.dds import messages, topics, types
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import NetworkOptions
from adapters.robots.g1.dds.remote import Sticks, remote_bytes
from adapters.robots.g1.twin import hands as twins
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.hands import inspire, wire
from adapters.robots.hands.hand import DdsHand
from adapters.robots.hands.kinds import DEX3_LEFT, DEX3_RIGHT, DFTP_RIGHT, DFX_BOTH, dex3_wire
from adapters.robots.hands.options import Dex3Options, HandOptions
from station import assets
from station.bus import codec
from station.control.command_validator import CommandSample, Samples
from station.control.control import ControlStep
from station.errors import NotReady
from station.parts import PartedCommand
from station.protocols import CommandFormat, Floats, JointTargets
from tests.adapters.robots.g1.dds.bench import SimulatedTime
from tests.dds_domains import domain

PERIOD_S, TWIN_S = 0.02, 0.002
CASES: dict[str, tuple[str, Any, Any, CommandFormat]] = {
    "dex3-left": ("dex3", DEX3_LEFT, lambda: dex3_wire("left", Dex3Options()), commands.TWIST2_LEFT),
    "dex3-right": ("dex3", DEX3_RIGHT, lambda: dex3_wire("right", Dex3Options()), commands.TWIST2_RIGHT),
    "dftp": (
        "inspire-dftp", DFTP_RIGHT, lambda: wire.DftpWire("right", inspire.JOINTS["right"]), commands.INSPIRE_RIGHT
    ),
    "dfx": ("inspire-dfx", DFX_BOTH, lambda: wire.DfxWire(*inspire.JOINTS.values()), commands.INSPIRE_BOTH),
}  # fmt: skip


class HandBench:
    """The twin's hands, and the control step of one of them."""

    def __init__(self, number: int, case: str) -> None:
        self.clock, self.faults, self.domain = SimulatedTime(), G1Faults(), number
        which, self.kind, make_wire, self.command = CASES[case]
        self.network = Network(NetworkOptions(domain=number))
        self.twins = twins.hands(self.network, which, "as-twist2")
        self.twin = self.twins[case.replace("dex3-", "") + "_hand"] if which == "dex3" else [*self.twins.values()][-1]
        self.clock.on_sleep = lambda seconds: self.advance(round(seconds / TWIN_S))
        self._ticks = 0
        self._make = lambda: DdsHand(make_wire(), HandOptions(domain=number), PERIOD_S, self.clock)
        self.wanted: list[Floats] | None = None
        self.events: list[tuple[str, str]] = []

    def plug_in(self) -> None:
        """Open the adapter, and put a control step over it."""
        self.robot = self._make()
        policy = DirectPolicy(assets.resolve(self.kind.checkpoint))
        self.control = ControlStep(self.robot, policy, self.command, is_armed=False, clock=self.clock)

    def change(self, **faults: Any) -> None:
        """Have other faults."""
        self.faults = msgspec.structs.replace(self.faults, **faults)

    def advance(self, ticks: int) -> None:
        """Move the twin's hands on alone."""
        for _ in range(max(1, ticks)):
            self._ticks += 1
            says = self._ticks % twins.TICKS_PER_STATE == 0
            for each in self.twins.values():
                each.tick(self._ticks * TWIN_S, TWIN_S, self.faults, is_heard=True, says=says)
            self.clock.now_ns += round(TWIN_S * 1e9)

    def run(self, seconds: float) -> None:
        """Move both on; commands are written anew in each period while there are any."""
        for _ in range(round(seconds / PERIOD_S)):
            self.advance(round(PERIOD_S / TWIN_S))
            now_s = self.clock.monotonic_s()
            samples: Samples = None
            if self.wanted is not None:
                told = tuple(CommandSample(codec.json_vector(each), arrived_s=now_s) for each in self.wanted)
                samples = told if isinstance(self.command, PartedCommand) else told[0]
            elif isinstance(self.command, PartedCommand):
                samples = (None, None)
            record = self.control.step(self.control.sense(), samples, now_s)
            self.events += [(each.name, str(each.detail.get("reason", ""))) for each in record.step_events]

    def want(self, part: float) -> None:
        """Ask for all fingers to be closed by a part from now on."""
        formats = self.command.parts if isinstance(self.command, PartedCommand) else (self.command,)
        self.wanted = [
            each.opened + part * (each.closed - each.opened) for each in formats if isinstance(each, HandCommand)
        ]

    def arm(self) -> None:
        """Arm, and let the ramp end."""
        self.run(0.1)
        assert self.control.arm(self.clock.monotonic_s()) == ""
        self.run(2.2)
        assert self.control.arming.state == "armed"

    @property
    def q(self) -> Floats:
        """Where the twin's joints are, in the order of the station."""
        told = {}
        for each in self.twins.values() if isinstance(self.command, PartedCommand) else [self.twin]:
            told |= each.health()["q"]
        return np.array([told[name] for name in self.robot.joint_names])

    def reason(self, name: str) -> str:
        """Return the reason of the newest event of a name."""
        return next(reason for each, reason in reversed(self.events) if each == name)


@contextmanager
def bench(case: str) -> Iterator[HandBench]:
    with domain() as number:
        found = HandBench(number, case)
        try:
            found.plug_in()
            try:
                yield found
            finally:
                found.robot.close()
        finally:
            found.network.close()


@pytest.mark.parametrize("case", CASES)
def test_a_hand_is_told_nothing_before_it_is_armed_then_closes_opens_and_is_recorded(case: str) -> None:
    with bench(case) as found:
        found.want(1.0)
        found.run(0.5)
        assert found.twin.counts["accepted"] == 0
        found.wanted = None
        found.run(1.0)
        before = found.q
        found.arm()
        assert found.q == pytest.approx(before, abs=0.02), "to be armed moves nothing"
        found.want(1.0)
        found.run(2.5)
        assert found.q == pytest.approx(np.concatenate(found.wanted or []), abs=0.05)
        rows = np.frombuffer(found.robot.values()["samples"])
        assert rows.reshape(-1, len(found.robot.joint_names) * len(CASES[case][2]().columns)).shape[0] > 1
        found.want(0.0)
        found.run(2.5)
        assert found.q == pytest.approx(np.concatenate(found.wanted or []), abs=0.05)
        assert found.twin.counts["refused"] == 0


@pytest.mark.parametrize("case", CASES)
def test_a_hand_whose_commander_falls_silent_goes_on_holding(case: str) -> None:
    with bench(case) as found:
        found.arm()
        found.want(0.6)
        found.run(2.0)
        held = found.q
        found.wanted = None
        found.run(3.0)
        assert found.q == pytest.approx(held, abs=0.02)
        assert found.control.arming.state == "armed"


@pytest.mark.parametrize("case", ["dex3-left", "dex3-right"])
def test_what_a_dex3_holds_is_pressed_with_no_more_than_its_lead_and_let_go_without_force(case: str) -> None:
    with bench(case) as found:
        assert isinstance(found.twin, twins.Dex3Hand)
        found.arm()
        found.change(holds={case.removeprefix("dex3-"): 0.5})
        found.want(1.0)
        found.run(2.0)
        assert 0.1 < np.abs(found.twin.fingers.tau).max() < 1.25
        found.control.disarm()
        found.run(0.1)
        assert not any(gains.any() for gains in found.twin.gains)


def test_a_dex3_whose_station_dies_goes_limp_by_itself_and_inspires_hand_holds_on() -> None:
    for case in ("dex3-left", "dftp"):
        with bench(case) as found:
            found.arm()
            found.want(0.5)
            found.run(1.0)
            held = found.q
            found.advance(450)
            assert found.twin.health().get("is_stiff", True)
            found.advance(100)
            assert found.twin.health().get("is_stiff", False) is False
            assert found.q == pytest.approx(held, abs=0.05)


@pytest.mark.parametrize(
    ("case", "faults", "words"),
    [
        ("dex3-right", {"hand_silent": ("right",)}, "no state of the hand for 0.3"),
        ("dfx", {"hand_silent": ("left",)}, "on rt/inspire/state"),
        ("dex3-left", {"hand_error": {"left_hand_thumb_1": 3}}, "motor left_hand_thumb_1 reports the error 0x3"),
        ("dftp", {"hand_error": {"right_hand_ring": 1}}, "motor right_hand_ring reports the error 0x1"),
    ],
)
def test_a_hand_that_is_not_well_is_given_up_with_the_reason_and_armed_by_a_person_alone(
    case: str, faults: dict[str, Any], words: str
) -> None:
    with bench(case) as found:
        found.arm()
        found.change(**faults)
        found.run(3.0)
        assert words in found.reason("robot-fault")
        assert found.control.arming.state == "disarmed"
        assert words.removesuffix(" 0.3") in found.control.arm(found.clock.monotonic_s())
        found.change(hand_silent=(), hand_error={})
        found.run(1.0)
        assert found.control.arming.state == "disarmed"
        assert found.control.arm(found.clock.monotonic_s()) == ""


def test_the_other_hand_goes_on_while_one_is_silent() -> None:
    with bench("dex3-left") as found:
        found.change(hand_silent=("right",))
        found.arm()
        found.want(1.0)
        found.run(2.0)
        assert found.control.arming.state == "armed"


@pytest.mark.parametrize("held", [("select",), ("L2", "B", "up")])
def test_what_stops_the_robot_on_its_remote_stops_the_hand(held: tuple[str, ...]) -> None:
    with bench("dex3-left") as found, Network(NetworkOptions(domain=found.domain)) as robot:
        assert isinstance(found.twin, twins.Dex3Hand)
        states, state = robot.writer(topics.LOW_STATE, raw(types.LowState)), messages.new_state()

        def say(*buttons: str) -> None:
            state["remote"] = remote_bytes(buttons, Sticks(0.0, 0.0, 0.0, 0.0))
            states.write(messages.signed(state))
            states.write(messages.signed(state))

        found.arm()
        say()
        found.run(0.1)
        assert found.control.arming.state == "armed"
        say(*held)
        found.run(0.06)
        assert "on the remote" in found.reason("robot-fault")
        assert not any(gains.any() for gains in found.twin.gains)


def test_another_program_that_writes_to_the_hand_is_named() -> None:
    with bench("dex3-left") as found, Network(NetworkOptions(domain=found.domain)) as stranger:
        writer = stranger.writer("rt/dex3/left/cmd", raw(types.HandCmd))
        found.run(0.5)
        assert "another program writes rt/dex3/left/cmd: " in found.control.arm(found.clock.monotonic_s())
        del writer


@pytest.mark.parametrize(("field", "value"), [("kp", 40.0), ("kd", -0.1), ("q", np.nan), ("kp", np.nan)])
def test_what_no_hand_may_be_asked_for_takes_its_force_away(field: str, value: float) -> None:
    with bench("dex3-left") as found:
        assert isinstance(found.twin, twins.Dex3Hand)
        found.arm()
        good = {"q": np.zeros(7), "kp": np.full(7, 1.5), "kd": np.full(7, 0.2)}
        sent = found.robot.write(JointTargets(**good | {field: np.full(7, value)}))
        assert not sent.kp.any()
        found.advance(10)
        assert not any(gains.any() for gains in found.twin.gains)
        assert found.robot.why_not_drive()
        found.robot.damp()
        assert found.robot.why_not_drive() == "", "it was told, and is disarmed"


def test_commands_that_ask_for_what_no_motor_may_do_reach_none() -> None:
    motor, go = types.MotorCmd(0x90, 0.5, 0.0, 0.0, 1.5, 0.2, 0), types.GoMotorCmd(1, 0.5, 0.0, 0.0, 0.0, 0.0, [0] * 3)
    nan, locked = types.MotorCmd(0x90, np.nan, 0, 0, 1.5, 0.2, 0), types.MotorCmd(0x8F, 1.0, 0, 0, 1.5, 0.2, 0)
    go_nan, six = types.GoMotorCmd(1, np.nan, 0, 0, 0, 0, [0] * 3), [500] * 6
    bad: dict[str, list[Any]] = {
        "dex3-left": [types.HandCmd(motors, [0] * 4) for motors in ([motor] * 6, [motor] * 8, [], [nan] * 7)],
        "dfx": [types.MotorCmds(motors) for motors in ([go] * 6, [], [go] * 11 + [go_nan])],
        "dftp": [types.InspireCtrl(six, *rest) for rest in ((six, six, six, "\x02"), ([500] * 5, six, six, "\x01"))],
    }  # fmt: skip
    for case, commanded in bad.items():
        with bench(case) as found, Network(NetworkOptions(domain=found.domain)) as stranger:
            before = found.q
            spoken = CASES[case][2]()
            writer = stranger.writer(spoken.command_topic, getattr(types, spoken.command_type))
            for message in commanded:
                writer.write_object(message)
                found.advance(5)
            assert found.twin.counts == {"refused": len(commanded), "states": found.twin.counts["states"]}
            if case == "dex3-left":
                writer.write_object(types.HandCmd([locked] * 7, [0] * 4))  # one, but of other motors
                found.advance(50)
            assert found.q == pytest.approx(before, abs=1e-6)


def test_a_hand_that_is_not_there_is_named_with_its_topic() -> None:
    with domain() as number:
        options = Dex3Options(domain=number, first_state_within_s=0.1)
        with pytest.raises(NotReady, match=r"no state of the hand within 0\.1 s on rt/dex3/left/state .* nothing came"):
            DdsHand(dex3_wire("left", options), options, PERIOD_S)


@pytest.mark.parametrize(("case", "follows"), [("dex3-left", True), ("dftp", False)])
def test_a_program_that_never_pauses_is_followed_once_the_hand_is_armed_where_it_is_a_stock_one(
    case: str, follows: bool
) -> None:
    with bench(case) as found:
        found.want(0.0)
        found.run(1.0)
        found.arm()
        found.want(1.0)
        found.run(2.5)
        assert np.allclose(found.q, np.concatenate(found.wanted or []), atol=0.05) is follows
