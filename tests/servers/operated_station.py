"""A G1 that an operator drives, under test: bus, G1, fake headset, teleoperation server, each a process of its own.

Who drives it does one thing after another, each until it has come about, so that it takes as long as the machine needs.
On one that is busy the headset may look silent for a moment: then driving ends, as it should, and is begun anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from adapters.devices.pico.kind import PicoConfig
from adapters.robots.g1 import twist_keys
from servers.g1 import G1Config
from servers.recorder import RecorderConfig
from servers.teleop import TeleopConfig
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Write
from station.control.gate import GateConfig
from station.control.rig import PolicyChoice
from station.life.events import Event
from station.life.restarts import Restarts
from station.protocols import FALL_TILT_RAD, Floats
from station.rotations import tilt
from station.supervision.supervisor import Supervisor
from tests.servers.engagements import jumps_at_engaging
from tests.servers.g1_station import ROBOT, Log
from tests.servers.worn_headset import AGAIN_S, PRESS_S, WornHeadset
from tests.waiting import wait_until

START_PAUSE = "right_primary"
UPRIGHT_M = 0.4
TIMEOUT_S = 90.0
PATIENT = GateConfig(hold_after_s=1.5, return_after_s=4.0)
"""These tests are about who drives, and not about a robot whose commands are late: that is the gate's."""

_SEEN = 20  # looks of the device server: what drives has then seen that nothing is pressed


class OperatedStation:
    """A context manager; leaves no process behind.

    Args:
        folder: For everything that is written.
        controls: Where there are any, a fake headset plays them at their times, in place of one that the test wears.
        faults: Of that script.
        motion: What the wearer of the headset does.
        record: Whether there is a recorder.
        start_armed: Whether the robot starts armed.
        gate: The robot's patience.
        policies: By name, those that may take over from the robot's first policy.
        teleop: Settings of the teleoperation server.
    """

    def __init__(
        self,
        folder: Path,
        controls: Sequence[Mapping[str, Any]] = (),
        faults: Sequence[Mapping[str, Any]] = (),
        *,
        motion: str = "builtin:wave",
        record: bool = False,
        start_armed: bool = True,
        gate: GateConfig = PATIENT,
        policies: Mapping[str, PolicyChoice] | None = None,
        **teleop: Any,
    ) -> None:
        self.data = folder / "data"
        self.headset = None if controls else WornHeadset(motion)
        script = {"motion": motion, "repeat": "swing", "controls": list(controls), "faults": list(faults)}
        (folder / "script.json").write_text(json.dumps(script))
        self.server = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
        self.bus = Bus(self.server.address, name="supervisor", timeout_s=5.0)
        self.log = Log(self.server.address)
        self.supervisor = Supervisor(self.bus, folder / "logs")
        try:
            g1 = G1Config(
                physics_dt_s=0.002, real_time_priority=0, start_armed=start_armed, gate=gate,
                policies=dict(policies or {}), blend_s=0.1,
            )  # fmt: skip
            self._start("g1", g1)
            if record:
                self._start("recorder", RecorderConfig(data=self.data, min_free_mb=0))
            self._start("teleop", TeleopConfig(device="pico", **teleop))
            played = PicoConfig(fake=folder / "script.json")
            self._start("pico", PicoConfig(port=self.headset.port) if self.headset else played, Restarts())
            if self.headset is not None:
                self.wait_until_live()
        except BaseException:
            self.close()
            raise

    @property
    def worn(self) -> WornHeadset:
        """The headset that the test wears."""
        assert self.headset is not None, "a script plays"
        return self.headset

    # -- What the operator does --------------------------------------------------------------------------------------
    def press(
        self, *controls: str, until: Callable[[], object], for_s: float = PRESS_S, again_s: float = AGAIN_S
    ) -> None:
        """Press controls until something is so."""
        self.worn.press(*controls, until=until, for_s=for_s, again_s=again_s, timeout_s=TIMEOUT_S)

    @property
    def is_engaged(self) -> bool:
        """Whether the operator drives, by what was told."""
        told = self.told("operator-engaged", "operator-disengaged")
        return bool(told) and told[-1].name == "operator-engaged"

    def engage(self) -> None:
        """Begin to drive."""
        self.press(START_PAUSE, until=lambda: self.is_engaged)

    def let_go(self) -> None:
        """Drive no more, by the operator's own will."""
        count = len(self.reasons("released"))
        while len(self.reasons("released")) == count:
            self.engage()
            self.press(START_PAUSE, until=lambda: not self.is_engaged)

    def drive_until(self, condition: Callable[[], object]) -> None:
        """Drive until something is so."""

        def is_so() -> object:
            if not self.is_engaged:
                self.engage()
            return condition()

        wait_until(is_so, TIMEOUT_S)

    # -- What came of it ---------------------------------------------------------------------------------------------
    def reasons(self, *reasons: str) -> list[str]:
        """Return why driving ended each time, or only some of the reasons."""
        found = [str(event.detail["reason"]) for event in self.told("operator-disengaged")]
        return [reason for reason in found if not reasons or reason in reasons]

    def told(self, *names: str) -> list[Event]:
        """Return the events of some names, in order."""
        return self.log.events(*names)

    def wait_for(self, name: str, count: int = 1) -> Event:
        """Wait until something was told so often; return the event."""
        return self.log.wait_for(name, count, TIMEOUT_S)

    def why_not(self) -> str:
        """Return what the status line says of why nobody drives; "" where nothing is known."""
        health = self.supervisor.health("teleop")
        return str(health.detail.get("why_not", "")) if health is not None else ""

    def wait_for_gate(self, state: str) -> None:
        """Wait until the gate is in a state."""
        wait_until(lambda: self.log.gate()["state"] == state, TIMEOUT_S)

    def wait_until_live(self) -> None:
        """Wait until the device has been live for a moment from now on."""
        key = keys.operator_status("pico")
        since = len(self.log.of(key))
        wait_until(lambda: sum(b'"live"' in value for value in self.log.values(key)[since:]) > _SEEN, TIMEOUT_S)

    def wait_for_end(self) -> int:
        """Wait until the teleoperation server has ended by itself; return its exit code."""
        process = self.supervisor.children["teleop"].process
        return process.wait(TIMEOUT_S)

    def commands(self) -> list[tuple[int, Floats]]:
        """Return all commands with their places in the log."""
        return self._vectors(twist_keys.action_body(), codec.parse_json)

    def is_upright(self) -> bool:
        """Whether the robot has stood all the time."""
        poses = [codec.parse_f64(value) for value in self.log.values(keys.sim_qpos(ROBOT))]
        return all(float(tilt(pose[3:7])) < FALL_TILT_RAD and pose[2] > UPRIGHT_M for pose in poses)

    def restarts_at_engaging(self) -> list[float]:
        """Return how far the first command of each engaging was from the one before it."""
        return jumps_at_engaging(self.log)

    def close(self) -> None:
        self.log.close()
        if self.headset is not None:
            self.headset.close()
        if "teleop" in self.supervisor.children:
            self.supervisor.children["teleop"].process.kill()  # else it would take its two seconds to blend out
        self.supervisor.stop_all()
        self.bus.close()
        self.server.stop()

    def __enter__(self) -> OperatedStation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _vectors(self, key: str, parse: Any) -> list[tuple[int, Floats]]:
        return [(index, np.array(parse(write.value))) for index, write in self._writes() if write.key == key]

    def _writes(self) -> list[tuple[int, Write]]:
        return [(index, write) for index, write in enumerate(list(self.log.writes)) if write.value is not None]

    def _start(self, name: str, config: Any, restarts: Restarts | None = None) -> None:
        self.supervisor.spawn(name, config, restarts=restarts)
        self.supervisor.wait_for(name, "inactive", 60)
        self.supervisor.activate(name)
        self.supervisor.wait_for(name, "active", 60)
