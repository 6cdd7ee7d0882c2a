"""A G1's twin and the control step of the real robot over one network in this process, in simulated time.

Messages pass through Cyclone DDS itself, which hands them over at once within a process. So a test says when what
happens, and is as fast as the physics.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import msgspec
import numpy as np

from adapters.policies.default_pose import DefaultPosePolicy
from adapters.policies.tracker.policy import TrackerPolicy
from adapters.robots.g1.dds.options import G1DdsOptions
from adapters.robots.g1.dds.robot import G1Dds
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.g1.twin.options import G1TwinOptions
from adapters.robots.g1.twin.twin import G1Twin
from station import assets
from station.clock import Clock
from station.command_formats import command_format
from station.control.command_validator import CommandSample
from station.control.control import ControlStep, StepRecord
from station.control.policy_switch import PolicySwitch
from station.protocols import Policy
from tests.dds_domains import domain

PERIOD_S = 0.02
TICKS = 10  # of the twin in a control period


@cache
def _policies() -> dict[str, Policy]:
    """Return the policies, loaded once: to load them takes longer than most that they are tried with."""
    tracker = assets.resolve("builtin:tracker.onnx")
    return {"default-pose": DefaultPosePolicy(tracker), "tracker": TrackerPolicy(tracker)}


class SimulatedTime(Clock):
    """A clock that the bench moves on; who sleeps moves the twin on."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000
        self.on_sleep: Any = lambda seconds: None

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.on_sleep(seconds)


class Bench:
    """Both sides; `run` moves them on together."""

    robot: G1Dds
    control: ControlStep

    def __init__(
        self, number: int, faults: G1Faults, twin: dict[str, Any], robot: dict[str, Any], policies: dict[str, Policy]
    ) -> None:
        self.clock = SimulatedTime()
        self.faults, self.domain = faults, number
        self.twin = G1Twin(G1TwinOptions(domain=number, **twin), faults)
        self._each = list(policies.values())
        self.policies = PolicySwitch(policies, period_s=PERIOD_S)
        self.events: list[tuple[str, str]] = []
        self.records: list[StepRecord] = []
        self.command: CommandSample | None = None
        self._options, self._is_plugged_in = robot, False
        self.clock.on_sleep = lambda seconds: self.advance(max(1, round(seconds / self.twin.period_s)))

    def plug_in(self) -> None:
        """Open the real robot's adapter, and put a control step over it."""
        for policy in self._each:
            policy.reset()
        self.advance(20)
        self.robot = G1Dds(G1DdsOptions(domain=self.domain, **self._options), PERIOD_S, self.clock)
        self._is_plugged_in = True
        spec = self._each[-1].spec
        followed = command_format(spec.command, "g1_29", spec.command_lower, spec.command_upper)
        self.control = ControlStep(self.robot, self.policies, followed, is_armed=False, clock=self.clock)

    def unplug(self) -> None:
        """Close the adapter, where it was opened; the second time does nothing."""
        if self._is_plugged_in:
            self._is_plugged_in = False
            self.robot.close()

    def change(self, **faults: Any) -> None:
        """Have other faults of the twin beside those that there are."""
        self.faults = msgspec.structs.replace(self.faults, **faults)
        self.twin.change(self.faults)

    def advance(self, ticks: int) -> None:
        """Move the twin on alone."""
        for _ in range(ticks):
            self.twin.tick()
            self.clock.now_ns += round(self.twin.period_s * 1e9)

    def run(self, seconds: float) -> None:
        """Move twin and control step on; keep what each step did."""
        for _ in range(round(seconds / PERIOD_S)):
            self.advance(TICKS)
            state = self.control.sense()
            record = self.control.step(state, self.command, self.clock.monotonic_s())
            self.records.append(record)
            self.events += [(event.name, str(event.detail.get("reason", ""))) for event in record.step_events]

    def release(self) -> None:
        """Have the robot's own controller let go, and wait until nothing is against arming for a while."""
        self.robot.release()
        calm = 0
        for _ in range(50):
            self.run(0.1)
            calm = 0 if self.robot.why_not_arm() else calm + 1
            if calm == 3:
                return
        raise AssertionError(self.robot.why_not_arm())

    def arm(self) -> None:
        """Arm, and let the ramp end."""
        assert self.control.arm(self.clock.monotonic_s()) == ""
        self.run(2.2)
        assert self.control.arming.state == "armed"

    def hang(self) -> None:
        """Hang on the gantry in the default pose, armed."""
        self.release()
        self.arm()

    def stand(self, policy: str = "tracker") -> None:
        """Come down from the gantry onto the feet, and let the policy balance."""
        self.release()
        self.change(gantry="down")
        self.arm()
        self.run(0.7)
        self.policies.switch(policy)
        self.run(0.8)
        self.change(gantry="slack")
        self.run(0.3)

    def reason(self, name: str) -> str:
        """Return the reason of the newest event of a name."""
        return next(reason for each, reason in reversed(self.events) if each == name)

    @property
    def is_damped(self) -> bool:
        """Whether the twin's motors hold damping, and nothing else."""
        held = self.twin.body.held
        return bool((held.kp == 0.0).all() and (held.kd > 0.0).all() and not np.any(held.tau))


@contextmanager
def bench(
    faults: G1Faults | None = None, *, twin: dict[str, Any] | None = None, policies: dict[str, Policy] | None = None,
    **robot: Any,
) -> Iterator[Bench]:  # fmt: skip
    """Have both sides on a network of their own."""
    with domain() as number:
        found = Bench(number, faults or G1Faults(), twin or {}, robot, policies or _policies())
        try:
            yield found
        finally:
            found.unplug()
            found.twin.close()
