"""A robot's server, command servers and operators on a bus in virtual time: the station's own code, each as a process.

Fakes are at the lowest layer alone: the network (`tests.virtual.network`), and a robot and a policy that are ideal.
"""

from __future__ import annotations

import contextlib
import json
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from servers.motion import MotionConfig, Player
from station import registry
from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.control.command_validator import Samples
from station.control.control import ControlStep, StepRecord
from station.control.gate import GateConfig
from station.control.low_level import LowLevelLoop, result_values
from station.errors import BusError, Refused
from station.life.estop import StopWatch
from station.life.events import Event, decode
from station.life.loop import Rate
from station.life.pace import WallPace
from station.life.server import Life, Role, ServerKind
from station.life.serving import serve
from station.life.supervisor_pipe import SupervisorPipe
from station.operator.device_subscriber import DeviceSample
from station.operator.driving import CommandWriter
from station.protocols import CommandFormat, Floats, Reference, RobotState
from tests.control.ideal_robot import IdealRobot, IdealSimulation, Obedient
from tests.virtual.clock import Process, VirtualClock
from tests.virtual.network import Network

FORMAT: CommandFormat = registry.find("command", "twist2")
RATE_HZ = 50.0
PERIOD_S = 1.0 / RATE_HZ
ELSEWHERE = "ffffffff"  # boot of another machine


class NoConfig(msgspec.Struct):
    """A server that is configured by its test."""


def kind(name: str, role: Role, main: Callable[[Any, Life], int]) -> ServerKind:
    """Return a server that runs a function of a test."""
    return ServerKind(name=name, role=role, summary="", config=NoConfig, main=main)


@dataclass(frozen=True, slots=True)
class Tick:
    """A control step: the instant that the loop gave it [s], what it did, and how armed the robot was after it."""

    now_s: float
    record: StepRecord
    arming: str

    @property
    def state(self) -> str:
        """State of the gate after it."""
        return self.record.decision.state

    @property
    def vector(self) -> Floats:
        """The command that the policy got, shape (m,)."""
        return self.record.decision.vector


class ControlledRobot:
    """A low-level server in a process of its own.

    Args:
        network: Its bus is there.
        is_simulated: Whether the robot is put on its feet by software; a real one starts disarmed.
        thinks_s: How long the policy takes, at least and at most [s].
        gate: Of the server's configuration.
    """

    def __init__(
        self,
        network: Network,
        *,
        is_simulated: bool = True,
        thinks_s: tuple[float, float] = (0.0, 0.0),
        gate: GateConfig | None = None,
    ) -> None:
        self.ticks: list[Tick] = []
        self.life: Life | None = None
        self.control: ControlStep | None = None
        self.gate = gate or GateConfig()
        self._is_simulated, self._thinks_s = is_simulated, thinks_s
        self._network = network
        server = kind("g1", "low-level", self._main)
        self.process = network.clock.spawn(lambda: _serve(server, network.address()), "g1")

    @property
    def newest(self) -> StepRecord:
        """What the newest step did."""
        return self.ticks[-1].record

    @property
    def state(self) -> str:
        """State of the gate; "" before the first step."""
        return self.ticks[-1].state if self.ticks else ""

    @property
    def refused(self) -> int:
        """How many commands were refused."""
        return self.control.commanded.validator.refused.total() if self.control is not None else 0

    def stop_past_the_bus(self) -> None:
        """Ask for the emergency stop as the supervisor does, by its pipe."""
        assert self.life is not None
        pipe = self.life._supervisor_pipe
        assert pipe is not None
        pipe.on_estop("a test")

    def _main(self, config: NoConfig, life: Life) -> int:
        clock = self._network.clock
        robot = (IdealSimulation if self._is_simulated else IdealRobot)(clock.monotonic_ns)
        policy = Thinking(clock, self._thinks_s)
        control = self.control = LoggedControl(
            robot, policy, FORMAT, gate=self.gate, is_armed=self._is_simulated, clock=clock, ticks=self.ticks
        )
        life._supervisor_pipe = _NoSupervisor()
        with LowLevelLoop(
            life,
            control,
            state_values=lambda state: {keys.robot_state(FORMAT.robot): codec.f64(state.q)},
            result_values=lambda record, answer: result_values(FORMAT.robot, record, control.commanded, answer),
            period_s=PERIOD_S,
        ) as loop:
            life.configured({"server": life.name, "robot": FORMAT.robot})
            if life.ready():
                self.life = life
                loop.run_at(Rate(RATE_HZ, life.clock))
        return 0


class _NoSupervisor(SupervisorPipe):
    """The end of a pipe that no supervisor holds: what is asked for on it is asked by the test."""

    def __init__(self) -> None:
        self.activated = threading.Event()
        self.activated.set()
        self.on_estop = lambda _: None


class Thinking(Obedient):
    """A policy that takes time."""

    def __init__(self, clock: VirtualClock, thinks_s: tuple[float, float]) -> None:
        super().__init__()
        self._clock, self._thinks_s = clock, thinks_s

    def act(self, observation: Any) -> Any:
        if self._thinks_s[1] > 0.0:
            self._clock.sleep(self._clock.random.uniform(*self._thinks_s))
        return super().act(observation)


class LoggedControl(ControlStep):
    """A control step that keeps what it did."""

    def __init__(self, *arguments: Any, ticks: list[Tick], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._ticks = ticks

    def step(self, state: RobotState, sample: Samples, now_s: float) -> StepRecord:
        record = super().step(state, sample, now_s)
        self._ticks.append(Tick(now_s, record, self.arming.state))
        return record


def _serve(server: ServerKind, address: BusAddress, name: str = "") -> None:
    """Serve, as `station serve` does; a bus that is away at the start, or a stop, ends it with a word."""
    with contextlib.suppress(BusError, Refused):
        serve(server, NoConfig(), address=address, name=name)


# ---- who commands ----


@dataclass(frozen=True, slots=True)
class Walk:
    """A motion that walks on with a speed of its own and swings its knees.

    Attributes:
        speed: Of the root along x [m/s].
        swing_rad: Of the knees [rad].
    """

    speed: float
    swing_rad: float
    name: str = "walk"
    joint_names: tuple[str, ...] = G1_29
    duration_s: float = 3600.0
    fps: float = 50.0

    def at(self, time_s: float) -> Reference:
        q = FORMAT.default[6:].copy()
        q[3], q[9] = (0.4 + self.swing_rad * math.sin(3.0 * time_s + phase) for phase in (0.0, math.pi))
        return Reference(
            root_pos=np.array([0.0, 0.0, 0.78]), root_quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
            root_lin_vel=np.array([self.speed, 0.1, 0.0]), root_ang_vel=np.array([0.0, 0.0, 0.3]), q=q,
        )  # fmt: skip

    def facts(self) -> dict[str, Any]:
        return {"file": "walk", "sha256": "", "first_frame": 0}

    def vector(self, time_s: float) -> Floats:
        """Return the command at a time."""
        return FORMAT.encode(self.at(time_s), self.joint_names)


@dataclass
class Commander:
    """Whoever writes commands, in a process of its own.

    Attributes:
        kind: What it is: see `COMMANDERS`.
        walk: What it commands.
        process: Its process.
        life: Of a server of ours, once it runs.
        is_leaving: Set to have a writer that is no server of ours leave.
    """

    kind: str
    walk: Walk
    process: Process
    life: list[Life] = field(default_factory=list)
    is_leaving: bool = False

    def leave(self) -> None:
        """Ask it to finish."""
        self.is_leaving = True
        for life in self.life:
            life.stop_event.set()


def commander(network: Network, name: str, what: str, walk: Walk) -> Commander:
    """Start one that commands."""
    found = Commander(what, walk, Process(name))

    def run() -> None:
        COMMANDERS[what](network, found, name)

    found.process = network.clock.spawn(run, name)
    return found


def _motion(network: Network, commander: Commander, name: str) -> None:
    """The motion server's player."""

    def main(config: NoConfig, life: Life) -> int:
        commander.life.append(life)
        watched = [FORMAT.key, keys.MOTION_CONTROL, twist_keys.MOTION_START_SIGNAL, twist_keys.MOTION_EXIT_SIGNAL,
                   *StopWatch.watched(FORMAT.robot)]  # fmt: skip
        with life.bus.watch(watched) as watch:
            if life.ready():
                Player(MotionConfig(motion="walk", enter_s=0.2, leave_s=0.3), life, commander.walk, FORMAT, watch).run()
        return 0

    _serve(kind("motion", "command", main), network.address(), name)


def _teleop(network: Network, commander: Commander, name: str) -> None:
    """The teleoperation server's writer, at its pace."""

    def main(config: NoConfig, life: Life) -> int:
        commander.life.append(life)
        writer = CommandWriter(life, FORMAT, device="pad", driver="walk")
        if not life.ready():
            return 0
        pace, time_s = WallPace(RATE_HZ, life.clock), 0.0
        while not life.stopping:
            writer.write(commander.walk.vector(time_s), FORMAT.auxiliary, DeviceSample(None), engaged=True)
            life.report(**pace.health())
            time_s += pace.wait(is_leaving=False)
        return 0

    _serve(kind("teleop", "command", main), network.address(), name)


def _plain(network: Network, commander: Commander, mark: Callable[[int], list[bytes]]) -> None:
    """A script that sends with a client of its own, and connects again where it has lost the bus."""
    clock, line, count = network.clock, None, 0
    began_s = clock.monotonic_s()
    while not commander.is_leaving:
        count += 1
        value = codec.json_vector(commander.walk.vector(clock.monotonic_s() - began_s))
        try:
            line = line or Connection(network.address(), timeout_s=5.0)
            line.call("MSET", FORMAT.key, value, *mark(count))
        except BusError:
            line = None
        clock.sleep(PERIOD_S)
    if line is not None:
        line.close()


def _stock(network: Network, commander: Commander, name: str) -> None:
    """A stock script: no stamps."""
    _plain(network, commander, lambda count: [])


def _elsewhere(network: Network, commander: Commander, name: str) -> None:
    """A server on another machine, whose clock says nothing here."""
    clock = network.clock

    def mark(count: int) -> list[bytes]:
        made = stamp.Stamp(count, clock.monotonic_ns() // 7, clock.wall_ns(), f"{name}.1.{ELSEWHERE}.n")
        return [keys.stamp(FORMAT.key).encode(), made.encode()]

    _plain(network, commander, mark)


COMMANDERS: dict[str, Callable[[Network, Commander, str], None]] = {
    "motion": _motion, "teleop": _teleop, "stock": _stock, "elsewhere": _elsewhere,
}  # fmt: skip
"""Who may command: servers of ours, a stock script, a server on another machine."""


# ---- what is told ----


def events(network: Network, name: str) -> list[Event]:
    """Return the events of a name that were told on a bus, in order."""
    key = keys.EVENT.encode()
    told = [decode(value) for _, written, value in network.server.journal if written == key and value is not None]
    return [event for event in told if event is not None and event.name == name]


def states(robot: ControlledRobot, since: int = 0) -> list[str]:
    """Return the states of a robot's gate, tick by tick, from a tick on."""
    return [tick.state for tick in robot.ticks[since:]]


# ---- who asks ----


def ask(network: Network, act: Callable[[Bus], object]) -> None:
    """Do something on the bus as an operator does, in a process of its own that ends with it; not for ever."""

    def run() -> None:
        try:
            with Bus(network.address(), name="operator", timeout_s=1.0) as bus:
                act(bus)
        except BusError:
            pass  # the operator is told, and asks again

    network.clock.spawn(run, "operator")


def request_to(action: str) -> bytes:
    """Return a request to arm or disarm the robot."""
    return json.dumps({"action": action, "id": "x", "who": "anna"}).encode()
