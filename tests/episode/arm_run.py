"""An episode of an arm that was driven, without a bus or a controller: the real control step, on times chosen here."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from adapters.commands.arm import arm_command
from adapters.robots import arm_limits
from adapters.robots.kassow.names import KR810_ROBOT
from station.bus import codec, keys, robot_streams
from station.clock import Clock
from station.config import to_plain
from station.control.arm_control import ArmControl, result_values
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig
from station.protocols import Floats
from tests.control.ideal_arm import TICK_S, IdealArm
from tests.episode.synthetic import MONO_START_NS, EpisodeBuilder

ROBOT = KR810_ROBOT
FORMAT = arm_command("kassow", arm_limits.load("kassow", "kr810"), speed_rad_s=1.0)


@dataclass
class ArmRun:
    """Drives an ideal arm tick by tick and writes what its server and its commander would.

    Attributes:
        builder: Where it goes.
        beats: Heartbeats per tick that the session hears: 1, or less for one that misses some.
        floods: Whether targets are sent though they stand.
        writer: Name of its server.
        delay_s: Time from the writing of a command to its arrival [s].
        latency_s: 99th percentile of the time from a heartbeat to the sending of a command [s].
    """

    builder: EpisodeBuilder
    beats: float = 1.0
    floods: bool = False
    arm: IdealArm = field(default_factory=IdealArm)
    seq: int = 0
    ticks: int = 0
    sends: int = 0
    faults: int = 0
    writer: str = "kassow"
    delay_s: float = 0.0002
    latency_s: float = 3e-6

    def __post_init__(self) -> None:
        # On the times of the episode: the machine's own would pass for it where a test takes as long as its arm.
        self.clock = _Ticks(self)
        self.control = ArmControl(self.arm, FORMAT, gate=GateConfig(), is_armed=True, clock=self.clock)
        self._sample: CommandSample | None = None
        self._is_due = False

    @property
    def at_s(self) -> float:
        """Time of the present tick from the start of the episode [s]."""
        return 0.1 + self.ticks * TICK_S

    def tick(self, command: Floats | None = None) -> None:
        """Let a tick pass; write what happens in it."""
        self.ticks += 1
        self.arm.pass_tick()
        if command is not None:
            self._hear(command)
        state = replace(self.control.sense(), mono_ns=self.clock.monotonic_ns())
        if self.ticks % 2:
            self._write_state(state.q)
        record = self.control.step(state, self._sample, MONO_START_NS * 1e-9 + self.at_s)
        self._is_due |= record.is_sent or self.floods
        if self.ticks % 2 and self._is_due:  # a throttle of 2
            self.sends, self._is_due = self.sends + 1, False
        values = result_values(ROBOT, record, self.control.commanded, None, None)
        self.builder.write(values, at_s=self.at_s + 0.0002, writer=self.writer)

    def move(self, seconds: float) -> None:
        """Move joint 1 at 0.3 rad/s."""
        command = self.arm.goal.copy()
        for _ in range(round(seconds / TICK_S)):
            command = command + 0.3 * TICK_S * np.eye(7)[0]
            self.tick(command)

    def hold(self, seconds: float) -> None:
        """Go on commanding where the arm is asked to be."""
        command = self.arm.goal.copy()
        for _ in range(round(seconds / TICK_S)):
            self.tick(command)

    def be_silent(self, seconds: float) -> None:
        """Command nothing."""
        for _ in range(round(seconds / TICK_S)):
            self.tick()

    def finish(self, **gate: Any) -> Path:
        """Close the episode, with what the arm's server states; return its folder."""
        facts = {
            "server": "kassow", "role": "low-level", "robot": ROBOT, "command": FORMAT.facts(),
            "gate": to_plain(GateConfig()) | gate,
        }  # fmt: skip
        return self.builder.finish({"servers": {"kassow": facts}})

    def _hear(self, command: Floats) -> None:
        value, at_s = codec.json_vector(command), self.at_s - 0.0008
        self.seq += 1
        self.builder.write({keys.action_joints(ROBOT): value}, at_s=at_s, writer="teleop")
        arrived_ns = MONO_START_NS + round(at_s * 1e9)
        written_ns = arrived_ns - round(self.delay_s * 1e9)
        delay_s = (arrived_ns - written_ns) * 1e-9
        self._sample = CommandSample(
            value, arrived_s=arrived_ns * 1e-9, delay_s=delay_s, written_ns=written_ns, arrived_ns=arrived_ns,
            seq=self.seq, source="teleop.100.boot.beef",
        )  # fmt: skip

    def _write_state(self, q: Floats) -> None:
        counted = dict.fromkeys(robot_streams.COUNTERS, 0.0)
        counted |= {"tick": float(int(self.ticks * self.beats)), "stream_j_sends": float(self.sends),
                    "fault_count": float(self.faults)}  # fmt: skip
        times = [2e-6, 2e-6, self.latency_s, 9e-6, 0.004, 0.0041, 0.0045, np.nan]
        word = {"backend": "sim", "profile": "speed125", "lead_rad": self.arm.lead_rad}
        rates = self.builder.rates(keys.state_joints(ROBOT), q, at_s=self.at_s)
        values = {
            keys.state_joints(ROBOT): codec.f64(np.concatenate([q, rates, np.zeros(7)])),
            keys.state_counters(ROBOT): codec.f64([*counted.values(), *times]),
        }
        if self.ticks % 24 == 1:
            values[keys.state_controller(ROBOT)] = codec.json_object(word)
        self.builder.write(values, at_s=self.at_s, writer=self.writer)


class _Ticks(Clock):
    """The instants of a run."""

    def __init__(self, run: ArmRun) -> None:
        self._run = run

    def monotonic_ns(self) -> int:
        return MONO_START_NS + round(self._run.at_s * 1e9)
