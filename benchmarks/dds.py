"""Benchmark: a G1's wire, a message at a time and a whole control period, beside what else drives a G1 from Python."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import msgspec
import numpy as np
from cyclonedds.core import InstanceState, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from adapters.robots.g1.dds import messages, rows, topics, types
from adapters.robots.g1.dds.command_sender import DirectSender
from adapters.robots.g1.dds.network import Network, cyclone_config, raw
from adapters.robots.g1.dds.options import LOOPBACK, G1DdsOptions, NetworkOptions
from adapters.robots.g1.dds.robot import G1Dds
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.g1.twin.options import G1TwinOptions
from adapters.robots.g1.twin.twin import G1Twin
from benchmarks import processes
from benchmarks.harness import Benchmark, Row, Settings, Statistic, Target, alternate, compare, mean, p50, p99
from station.clock import SYSTEM
from station.life.loop import Rate, real_time
from station.protocols import Floats, JointTargets

OURS, OBJECTS, CHECKED, FAR = "ours", "SDK's objects", "SDK's objects, checksum in Python", "far-unitree-sdk"

METHOD = """\
Under FIFO where that is permitted. *Message*: one at a time in one process, through Cyclone DDS. Ours takes the bytes
of a LowState, checks them and has them as a record; and fills a LowCmd, signs and writes it. *SDK's objects*: what
`unitree_sdk2_python` does, an object of each motor, re-created with the same types, **without a checksum**: the SDK's
is in a compiled library that comes with its sources alone, so this is the least that it can cost. *Checksum in Python*:
over the same objects, packed by `struct`, bit after bit. (`unitree-sdk2` 1.0.1 on PyPI lacks that library, and wants a
Cyclone DDS that has no wheel for this Python.) *Period*: the robot's twin in a process of its own sends 500 states a
second, and a process reads and commands at 50 Hz. Ours: `G1Dds`, which checks every state and hands it to the
recording, watches the battery, the remote, the motion switcher and other writers, and limits what it sends. *SDK's
objects*: a thread takes each state, as the SDK's does; the newest is used; no checksum. `far-unitree-sdk` 0.1.8:
threads in C++, the newest state as an object, its command repeated at 500 Hz. *CPU*: of the whole process. *Age*: from
the tick of the twin that measured a state to its use. All of it on domain 0 of the loopback, the only one that
`far-unitree-sdk` knows: run no twin there beside it."""

_HZ, _DT_S = 50.0, 0.02
_SWEEP_S = 0.0001  # by which a period is longer, so that the phase between robot and reader is every one in turn
_WARM_S = 1.0  # the first states, and who else is there
_DEPTH = 16  # messages that a reader keeps
_JOINTS = len(G1_29)
_COLUMNS, _VOLTAGE = rows.of(messages.new_state()).shape[1], 2 + 6 * _JOINTS  # of `rows.SAMPLES`
_STATES_PER_V = 4096  # the voltage of the twin's motors counts its states: the one thing that every contender tells
_TWIN_PRIORITY = 40  # as its server asks for
_Q, _KP, _KD = np.full(_JOINTS, 0.1), np.full(_JOINTS, 40.0), np.full(_JOINTS, 2.0)


class Seen(msgspec.Struct):
    """What a contender saw in a round.

    Attributes:
        read_us, write_us: Of each period [us].
        cpu_percent: Of the whole process.
        states_hz: States that it had in Python [1/s]; 0 where it does not tell.
        used: Of each period the number of the state that was used, and when [ns].
    """

    read_us: list[float]
    write_us: list[float]
    cpu_percent: float
    states_hz: float
    used: list[tuple[int, int]]


def run(settings: Settings) -> list[Row]:
    """Measure."""
    return [*_messages(settings), *_periods(settings)]


def _messages(settings: Settings) -> list[Row]:
    count = int(settings.pick(500, 20))
    acts = {"take and check a LowState": "take", "make and write a LowCmd": "write"}
    found = []
    with processes.Worker(wire) as worker:
        for what, act in acts.items():
            turns = {name: _asking(worker, act, name, count) for name in (OURS, OBJECTS, CHECKED)}
            taken = alternate(turns, settings.rounds)
            for baseline in (OBJECTS, CHECKED):
                for told, by in (("p50", p50), ("p99", p99)):
                    found.append(compare(f"{what}, {told}", "µs", taken[OURS], taken[baseline], by=by,
                                         baseline=baseline))  # fmt: skip
    return found


def _asking(worker: processes.Worker, *arguments: object) -> Callable[[], Any]:
    return lambda: worker.ask(*arguments)


@contextlib.contextmanager
def wire() -> Iterator[Callable[[str, str, int], list[float]]]:
    """Have both ends of a wire in this process; yields what takes or writes so many messages, and times each [us]."""
    with Network(NetworkOptions()) as network, contextlib.closing(_Objects()) as objects:
        hears = network.reader(topics.LOW_CMD, types.LowCmd, depth=1)
        robot, sender = network.writer(topics.LOW_STATE, raw(types.LowState)), DirectSender(network, _DT_S, SYSTEM)
        reader = network.reader(topics.LOW_STATE, types.LowState, _DEPTH)
        state = messages.new_state()

        def take() -> None:
            records = messages.intact_states(reader.take())
            assert len(records) == 1

        def take_checked() -> None:
            (message,) = objects.take()
            assert checksum_by_bits(message) == message.crc

        acts: dict[tuple[str, str], Callable[[], object]] = {
            ("take", OURS): take, ("take", OBJECTS): objects.take, ("take", CHECKED): take_checked,
            ("write", OURS): lambda: sender.send(state[0], _Q, _KP, _KD),
            ("write", OBJECTS): lambda: objects.send(_Q, lambda _: 0),
            ("write", CHECKED): lambda: objects.send(_Q, checksum_by_bits),
        }  # fmt: skip

        def act(what: str, name: str, count: int) -> list[float]:
            took_us = []
            for _ in range(count):
                reader.take(), objects.take(), hears.take()
                robot.write(messages.signed(state))
                began_ns = time.perf_counter_ns()
                acts[what, name]()
                took_us.append((time.perf_counter_ns() - began_ns) / 1e3)
            return took_us

        real_time()
        yield act


def checksum_by_bits(message: Any) -> int:
    """Return the checksum of a LowCmd or LowState, bit after bit over its C struct, as one does without a library."""
    motors: list[float] = []
    if isinstance(message, types.LowCmd):
        for motor in message.motor_cmd:
            motors += (motor.mode, motor.q, motor.dq, motor.tau, motor.kp, motor.kd, motor.reserve)
        packed = struct.pack(
            "<2B2x" + "B3x5fI" * messages.SLOTS + "4I", message.mode_pr, message.mode_machine, *motors, *message.reserve
        )
    else:
        for motor in message.motor_state:
            motors += (motor.mode, motor.q, motor.dq, motor.ddq, motor.tau_est, *motor.temperature, motor.vol,
                       *motor.sensor, motor.motorstate, *motor.reserve)  # fmt: skip
        imu = message.imu_state
        packed = struct.pack(
            "<2I2B2xI13fh2x" + "B3x4f2hf7I" * messages.SLOTS + "40B4I", *message.version, message.mode_pr,
            message.mode_machine, message.tick, *imu.quaternion, *imu.gyroscope, *imu.accelerometer, *imu.rpy,
            imu.temperature, *motors, *message.wireless_remote, *message.reserve,
        )  # fmt: skip
    register = 0xFFFFFFFF
    for (word,) in struct.iter_unpack("<I", packed):
        for bit in range(31, -1, -1):
            is_one = (register >> 31) ^ (word >> bit & 1)
            register = (register << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 * is_one)
    return register


class _Contender(Protocol):
    """Who reads a G1's states and commands it.

    Attributes:
        states: How many states it has had in Python so far; 0 where it does not tell.
    """

    states: int

    def read(self) -> float:
        """Have the newest state as arrays; return the voltage in it [V], 0 before the first."""
        ...

    def write(self) -> None:
        """Send a command."""
        ...

    def close(self) -> None:
        """Leave the network."""
        ...


class _Ours:
    """The station's adapter, and what a robot's server does with it in a period."""

    def __init__(self) -> None:
        self._robot, self._targets = G1Dds(G1DdsOptions(), _DT_S), JointTargets(_Q, _KP, _KD)
        self.states, self._voltage = 0, 0.0

    def read(self) -> float:
        self._robot.read()
        if recorded := self._robot.values().get("samples"):
            samples = np.frombuffer(recorded).reshape(-1, _COLUMNS)
            self.states += len(samples)
            self._voltage = float(samples[-1, _VOLTAGE])
        return self._voltage

    def write(self) -> None:
        self._robot.write(self._targets)

    def close(self) -> None:
        self._robot.close()


class _Objects:
    """Messages as objects of Cyclone's Python package, as Unitree's makes them."""

    def __init__(self) -> None:
        self._network = Network(NetworkOptions())  # has opened the domain, on the loopback alone
        self._participant = DomainParticipant(0)
        states = Topic(self._participant, topics.LOW_STATE, types.LowState)
        commands = Topic(self._participant, topics.LOW_CMD, types.LowCmd)
        self._reader = DataReader(self._participant, states, Qos(Policy.History.KeepLast(_DEPTH)))
        self._writer = DataWriter(self._participant, commands, Qos(Policy.History.KeepLast(1)))
        motors = [types.MotorCmd(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0) for _ in range(messages.SLOTS)]
        self._command: Any = types.LowCmd(0, 5, motors, [0] * 4, 0)
        self._newest: Any = None
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._follow)
        self.states = 0

    def take(self) -> list[Any]:
        """Return the states that came since the last call."""
        found: list[Any] = self._reader.take(_DEPTH)
        return found

    def send(self, q: Floats, checksum: Callable[[Any], int]) -> None:
        """Send a command."""
        for motor, position in zip(self._command.motor_cmd, q.tolist(), strict=False):
            motor.mode, motor.q, motor.kp, motor.kd = 1, position, 40.0, 2.0
        self._command.crc = checksum(self._command)
        self._writer.write(self._command)

    def follow(self) -> _Objects:
        """Have a thread take states as they come."""
        self._thread.start()
        return self

    def _follow(self) -> None:
        waits = WaitSet(self._participant)
        waits.attach(ReadCondition(self._reader, ViewState.Any | InstanceState.Any | SampleState.NotRead))
        while not self._is_over.is_set():
            waits.wait(duration(milliseconds=100))
            for state in self.take():
                self._newest = state
                self.states += 1

    def read(self) -> float:
        if (state := self._newest) is None:
            return 0.0
        for name in ("q", "dq"):
            np.array([getattr(motor, name) for motor in state.motor_state[:_JOINTS]])
        np.array(state.imu_state.quaternion), np.array(state.imu_state.gyroscope)
        return float(state.motor_state[0].vol)

    def write(self) -> None:
        self.send(_Q, lambda _: 0)

    def close(self) -> None:
        self._is_over.set()
        if self._thread.is_alive():
            self._thread.join()
        self._participant.__del__()
        self._network.close()


class _Far:
    """`unitree_interface`, which has one participant in a process, on domain 0."""

    states = 0

    def __init__(self) -> None:
        import unitree_interface as far

        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)  # it prints
        settings = cyclone_config(LOOPBACK)
        self._robot = far.create_robot(LOOPBACK, far.RobotType.G1, far.MessageType.HG, dds_config=settings)
        self._robot.set_control_mode(far.ControlMode.PR)

    def read(self) -> float:
        state = self._robot.read_low_state()
        np.array(state.motor.q), np.array(state.motor.dq), np.array(state.imu.quat), np.array(state.imu.omega)
        return float(state.motor.voltage[0])

    def write(self) -> None:
        command = self._robot.create_zero_command()
        command.q_target, command.kp, command.kd = _Q.tolist(), _KP.tolist(), _KD.tolist()
        self._robot.write_low_command(command)

    def close(self) -> None:
        del self._robot


MAKERS: dict[str, Callable[[], _Contender]] = {OURS: _Ours, OBJECTS: lambda: _Objects().follow(), FAR: _Far}


def be_robot(stop: processes.Stop) -> list[int]:
    """Be a robot until told to stop; return when it began to measure each state [ns]."""
    twin, began_ns = G1Twin(G1TwinOptions(is_released=True), G1Faults()), [0]
    real_time(_TWIN_PRIORITY)
    rate = Rate(1.0 / twin.period_s)
    with contextlib.closing(twin):
        while not stop():
            rate.wait()
            twin.change(G1Faults(state_delay_ms=0.0, voltage=len(began_ns) / _STATES_PER_V))
            began_ns.append(time.monotonic_ns())
            twin.tick()
    return began_ns


@contextlib.contextmanager
def drive(name: str) -> Iterator[Callable[[float], Seen]]:
    """Have a contender in this process; yields what has it read and command for so many seconds."""
    with contextlib.closing(MAKERS[name]()) as contender:
        processes.until(lambda: contender.read() > 0)
        real_time()

        def act(seconds: float) -> Seen:
            rate, seen = Rate(_HZ), Seen([], [], 0.0, 0.0, [])
            began_s, began_cpu_s, states = time.monotonic(), time.process_time(), contender.states
            for _ in range(round(seconds * _HZ)):
                rate.wait()
                rate.shift(_SWEEP_S)
                began_ns = time.monotonic_ns()
                voltage = contender.read()
                read_ns = time.monotonic_ns()
                contender.write()
                seen.read_us.append((read_ns - began_ns) / 1e3)
                seen.write_us.append((time.monotonic_ns() - read_ns) / 1e3)
                seen.used.append((round(voltage * _STATES_PER_V), read_ns))
            elapsed_s = time.monotonic() - began_s
            seen.cpu_percent = 100.0 * (time.process_time() - began_cpu_s) / elapsed_s
            seen.states_hz = (contender.states - states) / elapsed_s
            return seen

        act(_WARM_S)
        yield act


def _turn(name: str, seconds: float) -> Callable[[], Seen]:
    def turn() -> Seen:
        with processes.Worker(drive, name) as worker:  # gone before another one has its turn: each hears all of them
            found: Seen = worker.ask(seconds)
            return found

    return turn


def _periods(settings: Settings) -> list[Row]:
    names = [OURS, OBJECTS, *([FAR] if importlib.util.find_spec("unitree_interface") else [])]
    seconds = settings.pick(4.0, 1.0)
    with processes.Beside(be_robot) as robot:
        taken = alternate({name: _turn(name, seconds) for name in names}, settings.rounds)
        began_ns: list[int] = robot.stop()
    figures: dict[str, Callable[[Seen], list[float]]] = {
        "read": lambda seen: seen.read_us,
        "write": lambda seen: seen.write_us,
        "whole": lambda seen: (np.array(seen.read_us) + seen.write_us).tolist(),
        "age": lambda seen: [(used_ns - began_ns[number]) / 1e6 for number, used_ns in seen.used],
        "cpu": lambda seen: [seen.cpu_percent],
        "states": lambda seen: [seen.states_hz],
    }
    of = {(name, figure): [make(seen) for seen in taken[name]] for name in names for figure, make in figures.items()}

    def row(what: str, unit: str, figure: str, by: Statistic, baseline: str, target: Target | None = None) -> Row:
        theirs = of[baseline, figure]
        return compare(f"period: {what}", unit, of[OURS, figure], theirs, by=by, baseline=baseline, target=target)

    found = []
    for baseline in names[1:]:
        found += [
            row("read, p50", "µs", "read", p50, baseline),
            row("write, p50", "µs", "write", p50, baseline),
            row("both, p50", "µs", "whole", p50, baseline),
            row("both, p99", "µs", "whole", p99, baseline, Target(limit=600.0)),
            row("CPU", "%", "cpu", mean, baseline, Target(limit=6.0)),
            row("age of the state, p50", "ms", "age", p50, baseline),
            row("age of the state, p99", "ms", "age", p99, baseline, Target(limit=5.0)),
        ]
    return [*found, row("states at hand", "1/s", "states", mean, OBJECTS)]


BENCHMARK = Benchmark(name="dds", title="A G1's wire", method=METHOD, run=run)
