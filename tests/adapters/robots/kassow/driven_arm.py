"""An arm under test behind the native bridge, in exact virtual time, and who drives it."""

from __future__ import annotations

from typing import Any

import numpy as np

from adapters.commands.arm import arm_command
from adapters.robots import arm_limits
from adapters.robots.kassow import kinematics
from adapters.robots.kassow.session import KordSession
from station.bus import codec
from station.control.arm_control import ArmControl, ArmRecord
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig
from station.protocols import Floats

LIMITS = arm_limits.load("kassow", "kr810")
TICK_S = 0.004


class DrivenArm:
    """A commander, the gate, the session, the bridge and its simulator; time passes in `drive` alone."""

    def __init__(self, kord: Any) -> None:
        options = kord.SimOptions(clock="virtual", q_start=list(kinematics.REACHING_DOWN))
        limits = kord.Limits(
            **{name: getattr(LIMITS, name).tolist() for name in ("q_min", "q_max", "qd_max", "qdd_max")}
        )
        self.bridge = kord.KordBridge(limits=limits, sim=options, real_time_priority=0)
        self.simulator = self.bridge.simulator
        self.bridge.connect()
        self.bridge.step(5)
        profile = kord.PROFILES["speed125"]
        self.session = KordSession(self.bridge, profile, LIMITS, speed_rad_s=1.0, lead_s=0.05)
        self.control = ArmControl(self.session, arm_command("kassow", LIMITS), gate=GateConfig(), is_armed=True)
        self.ticks, self.sample = 0, None
        self.q: Floats = self.session.read().q

    def drive(self, ticks: int) -> ArmRecord:
        for _ in range(ticks):
            self.ticks += 1
            self.q = self.q + 0.001 * np.eye(7)[0]
            value = codec.json_vector(self.q)
            record = self.step(CommandSample(value, arrived_s=self.ticks * TICK_S, seq=self.ticks))
        return record

    def step(self, sample: CommandSample | None) -> ArmRecord:
        self.bridge.step(1)
        return self.control.step(self.control.sense(), sample, self.ticks * TICK_S)
