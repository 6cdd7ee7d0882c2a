"""A control step of an arm under test, an ideal arm, and a commander."""

from __future__ import annotations

import numpy as np

from adapters.commands.arm import arm_command
from adapters.robots import arm_limits
from station.bus import codec
from station.control.arm_control import ArmControl, ArmRecord
from station.control.command_path import StepEvent
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig
from station.protocols import Floats
from tests.control.ideal_arm import TICK_S, IdealArm

FORMAT = arm_command("kassow", arm_limits.load("kassow", "kr810"), speed_rad_s=1.0)
STEP = np.array([0.0012, 0, 0, 0, 0, 0, 0])
"""What 0.3 rad/s is in a tick."""


class Bench:
    """A control step, an ideal arm, and a commander that writes in each tick or is silent."""

    def __init__(self, *, is_armed: bool = True) -> None:
        self.arm = IdealArm()
        self.control = ArmControl(self.arm, FORMAT, gate=GateConfig(), is_armed=is_armed)
        self.now_s = 100.0
        self.sample: CommandSample | None = None
        self.told: list[StepEvent] = []
        self.seq = 0
        self.step()  # the gate's first instant, from which time passes

    @property
    def state(self) -> str:
        return self.control.commanded.gate.state

    def step(self, command: Floats | bytes | None = None) -> ArmRecord:
        self.now_s += TICK_S
        self.arm.pass_tick()
        if command is not None:
            self.seq += 1
            value = command if isinstance(command, bytes) else codec.json_vector(command)
            self.sample = CommandSample(value, arrived_s=self.now_s, seq=self.seq, source="teleop.1.b.n")
        record = self.control.step(self.control.sense(), self.sample, self.now_s)
        self.told += record.step_events
        return record

    def steps(self, seconds: float, command: Floats | None = None) -> ArmRecord:
        for _ in range(round(seconds / TICK_S)):
            record = self.step(command)
        return record

    def drive(self, ticks: int, start: Floats | None = None) -> Floats:
        """Move joint 1 at 0.3 rad/s; return the newest command."""
        command = self.arm.q.copy() if start is None else start
        for _ in range(ticks):
            command = command + STEP
            self.step(command)
        return command

    def names(self) -> list[str]:
        return [step_event.name for step_event in self.told]
