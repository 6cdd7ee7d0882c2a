"""An operator who drives through faults of all kinds: nothing is engaged without a fresh, held enable, and a new press.

Device server, teleoperation server and a robot's server that says what its gate does, each a process in virtual time on
a network that freezes and is cut. What the device gave, and when, is known; what was commanded bears its time in its
stamp.
"""

from __future__ import annotations

import math
import random
from typing import Any, NamedTuple

import msgspec
import pytest

from adapters.commands.twist2 import FORMAT
from servers import teleop
from servers.teleop import TeleopConfig
from station.bus import codec, keys, stamp
from station.bus.client import Bus
from station.errors import StationError
from station.life.server import Life, ServerKind
from station.life.serving import serve
from station.operator.device import Device, DeviceError, Source
from station.operator.sample import OperatorSample
from station.operator.serve import serve_device
from tests.examples import some
from tests.virtual.clock import Process, VirtualClock
from tests.virtual.network import Network
from tests.virtual.written import Log

SEEDS = some(range(12))
SECONDS = 12.0
FRESH_S = 0.1 + 0.1 + 0.25 + 0.1
"""The oldest sample by which anybody drives: live by its server's word, newly heard, on its way; and the ticks [s]."""

ENABLE = "left_bumper"


class Config(msgspec.Struct):
    pass


class Sample(NamedTuple):
    at_s: float
    is_held: bool


class Pad:
    """A gamepad with an enable button; the trial presses it and spoils it.

    Attributes:
        samples: What it gave, and when it was so.
    """

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.is_held = self.is_silent = self.is_stuck = self.is_torn = False
        self.samples: list[Sample] = []
        self._newest: OperatorSample | None = None

    def open(self) -> Device:
        if self.is_torn:
            raise DeviceError("no gamepad; plug it in")
        return self

    def read(self) -> OperatorSample | None:
        if self.is_torn:
            raise DeviceError("the gamepad was torn out; plug it in")
        if self.is_silent:
            return None
        if self._newest is None or not self.is_stuck:
            now_ns = self._clock.monotonic_ns()
            self.samples.append(Sample(now_ns * 1e-9, self.is_held))
            controls = {ENABLE: float(self.is_held), "left_stick_y": 0.5}
            self._newest = OperatorSample(capture_ns=now_ns, controls=controls)
        return self._newest

    def why_silent(self) -> str:
        return "the gamepad is silent"

    def facts(self) -> dict[str, Any]:
        return {"device": "gamepad"}

    def close(self) -> None:
        pass


class Command(NamedTuple):
    """What was commanded, when its writer wrote it [s]."""

    at_s: float
    is_engaged: bool


class Trial:
    """A station in virtual time."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock, self.network = clock, Network(clock, (20_000, 2_000_000))
        self.log, self.pad = Log(self.network), Pad(clock)
        self.robot = clock.spawn(self._robot, "robot")
        self.device = self._start_device()
        kind = ServerKind(name="teleop", role="command", summary="", config=TeleopConfig, main=teleop.main)
        config = TeleopConfig(device="gamepad", driver="walk", patience_s=1.0, rate_hz=20.0)
        self.teleop = clock.spawn(lambda: self._serve(kind, config), "teleop")

    def commands(self) -> list[Command]:
        """Return what was commanded, in the order in which it was written; a source is written before its stamp."""
        key, is_engaged = keys.command_source(FORMAT.robot), False
        written: dict[int, Command] = {}
        for write in self.log.writes:
            if write.key == key:
                is_engaged = codec.parse_json(write.value)["engaged"]
            elif write.key == keys.stamp(key):
                mark = stamp.decode(write.value)
                assert mark is not None
                written[mark.mono_ns] = Command(mark.mono_ns * 1e-9, is_engaged)
        return [written[at_ns] for at_ns in sorted(written)]

    def kill_device(self) -> None:
        """Kill the device server, and start another one."""
        self.clock.kill(self.device)
        self.device = self._start_device()

    def say_stop(self, value: bytes) -> None:
        self.network.server.put(0, keys.ESTOP.encode(), value)
        self.network.server.touch(0, "set", "$", keys.ESTOP.encode())

    def _start_device(self) -> Process:
        def main(_config: Config, life: Life) -> int:
            source = Source(open=self.pad.open)
            return serve_device(life, source, rate_hz=25.0, config={}, punctual=lambda: "as it was")

        kind = ServerKind(name="gamepad", role="sensor", summary="", config=Config, main=main)

        def run() -> None:
            try:
                self._serve(kind, Config())
            except StationError:  # no device, no bus, or the one before still seems to live: as a supervisor, try again
                self.clock.sleep(0.3)
                self.device = self._start_device()

        return self.clock.spawn(run, "gamepad")

    def _serve(self, kind: ServerKind, config: Any) -> None:
        assert serve(kind, config, address=self.network.address()) == 0

    def _robot(self) -> None:
        with Bus(self.network.address(), name="robot") as bus, bus.watch([FORMAT.key, keys.ESTOP]) as watch:
            while True:
                newest, stop = watch.latest(FORMAT.key, max_age_s=0.3), watch.latest(keys.ESTOP)
                state = "stopped" if stop is not None and stop.value != b"0" else "tracking" if newest else "waiting"
                bus.publish({keys.command_gate(FORMAT.robot): codec.json_object({"state": state, "arming": "armed"})})
                self.clock.sleep(0.05)


def spoil(trial: Trial, rng: random.Random) -> None:
    """Do something to an operator, or to what is between this one and the robot."""
    pad, network, clock = trial.pad, trial.network, trial.clock
    process, seconds = rng.choice((trial.device, trial.teleop, trial.robot)), rng.choice((0.02, 0.15, 0.4, 1.2))

    def for_a_while(name: str) -> None:
        setattr(pad, name, True)
        clock.call_at(clock.monotonic_ns() + round(seconds * 1e9), lambda: setattr(pad, name, False))

    rng.choice((
        lambda: setattr(pad, "is_held", not pad.is_held), lambda: setattr(pad, "is_held", True),
        lambda: setattr(pad, "is_held", False), lambda: for_a_while("is_silent"), lambda: for_a_while("is_stuck"),
        lambda: for_a_while("is_torn"), lambda: clock.freeze(process, seconds),
        lambda: network.freeze(process, seconds),
        lambda: network.cut(process), lambda: network.freeze_server(seconds), lambda: network.restart_server(0.3),
        trial.kill_device, lambda: trial.say_stop(b"1"), lambda: trial.say_stop(b"0"),
    ))()  # fmt: skip


def engage(trial: Trial) -> None:
    """Release the stop and press anew, as an operator does who wants to go on; what was spoilt has mostly healed."""
    trial.say_stop(b"0")
    trial.pad.is_held = False
    trial.clock.sleep(1.5)
    trial.pad.is_held = True
    trial.clock.sleep(0.5)


def drive(seed: int) -> tuple[Trial, float]:
    """Run a trial; return it, and when the operator pressed at the end, with nothing spoilt any more [s]."""
    rng = random.Random(seed)
    with pytest.MonkeyPatch.context() as patch, VirtualClock(seed, late_ns=2_000_000) as clock:
        patch.setattr("servers.teleop.real_time", lambda: "as it was")  # of the process that runs all tests
        trial = Trial(clock)
        clock.sleep(0.5)
        trial.pad.is_held = True
        end_s = clock.monotonic_s() + SECONDS
        while clock.monotonic_s() < end_s:
            if rng.random() < 0.4:
                engage(trial)
            clock.sleep(rng.choice((0.03, 0.1, 0.3, 0.8)))
            if rng.random() < 0.25:
                trial.pad.is_held = not trial.pad.is_held
            else:
                spoil(trial, rng)
        clock.sleep(1.5)
        trial.say_stop(b"0")
        trial.pad.is_held = False
        clock.sleep(2.0)
        pressed_s = clock.monotonic_s()
        trial.pad.is_held = True
        clock.sleep(FRESH_S)
        return trial, pressed_s


@pytest.mark.parametrize("seed", SEEDS)
def test_whatever_happens_nothing_is_engaged_without_a_fresh_held_enable_and_a_press_of_it(seed: int) -> None:
    play(seed)


def play(seed: int) -> None:
    """Run a trial and judge it."""
    trial, pressed_s = drive(seed)
    samples, commands = trial.pad.samples, trial.commands()
    ended_s, was_engaged = -math.inf, False
    for command in commands:
        told = f"seed {seed}, {command.at_s:.3f} s"
        if command.is_engaged:
            recent = [sample for sample in samples if command.at_s - FRESH_S <= sample.at_s <= command.at_s]
            assert any(sample.is_held for sample in recent), f"engaged without a fresh, held enable; {told}"
            if not was_engaged:
                seen = [sample for sample in samples if ended_s - FRESH_S <= sample.at_s <= command.at_s]
                released = next((number for number, sample in enumerate(seen) if not sample.is_held), None)
                assert released is not None, f"engaged anew by a button that was never released; {told}"
                assert any(sample.is_held for sample in seen[released:]), f"engaged by no press; {told}"
        elif was_engaged:
            ended_s = command.at_s
        was_engaged = command.is_engaged
    last = [command for command in commands if command.at_s >= pressed_s]
    assert any(command.is_engaged for command in last), f"a fresh press engages once all is well; seed {seed}"
