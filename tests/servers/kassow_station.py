"""A Kassow arm under test: bus, the arm's server in a process of its own, who moves a joint, all that is written."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from adapters.robots.kassow.names import KR810_ROBOT
from servers.kassow import KassowConfig
from station.bus import codec, keys, robot_streams
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.life import arm_request, controller_request
from station.protocols import Floats
from station.supervision.supervisor import Supervisor
from tests.servers.g1_station import Log
from tests.waiting import wait_until

ROBOT = KR810_ROBOT
TIMEOUT_S = 60.0


class ArmStation:
    """A context manager; leaves no process behind.

    Args:
        folder: For everything that is written.
        settings: Of the arm's server.
    """

    def __init__(self, folder: Path, **settings: Any) -> None:
        self.data = folder / "data"
        self.server = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
        self.bus = Bus(self.server.address, name="anna", timeout_s=5.0)
        self.log = Log(self.server.address)
        self.supervisor = Supervisor(self.bus, folder / "logs")
        try:
            self.start("kassow", KassowConfig(real_time_priority=0, **settings))
            self.log.last(keys.command_used(ROBOT))
        except BaseException:
            self.close()
            raise

    def start(self, name: str, config: Any) -> None:
        self.supervisor.spawn(name, config)
        self.supervisor.wait_for(name, "inactive", TIMEOUT_S)
        self.supervisor.activate(name)
        self.supervisor.wait_for(name, "active", TIMEOUT_S)

    def gate(self) -> dict[str, Any]:
        """The newest word of the gate."""
        return dict(codec.parse_json(self.bus.get(keys.command_gate(ROBOT)) or b"{}"))

    def wait_for_gate(self, state: str) -> None:
        try:
            wait_until(lambda: self.gate().get("state") == state, TIMEOUT_S)
        except AssertionError:
            raise AssertionError(f"gate is not {state}: {self.gate()}; {self.controller()}") from None

    def wait_until_left_alone(self) -> None:
        """Wait until the arm stands and nobody commands it, after a commander that has stopped.

        Its last write may reach the server later than the bus, when the gate has waited since a pause before it.
        """
        newest = self.bus.read([keys.action_joints(ROBOT)])[keys.action_joints(ROBOT)].stamp
        assert newest is not None
        wait_until(lambda: self.command_seq() == newest.seq, TIMEOUT_S)
        self.wait_for_gate("waiting")
        self.wait_for_rest()

    def command_seq(self) -> float:
        """Number of the newest good command that the server has had, as its commander counts."""
        return float(codec.parse_json_vector(self.bus.get(keys.policy_timing(ROBOT)) or b"")[1])

    def used(self) -> Floats:
        """The command that the arm follows; where it is, when nobody commands."""
        return codec.parse_f64(self.bus.get(keys.command_used(ROBOT)) or b"")

    def joints(self) -> Floats:
        """Where the joints are [rad]."""
        return codec.parse_f64(self.bus.get(keys.state_joints(ROBOT)) or b"")[:7]

    def counters(self) -> dict[str, float]:
        """The newest values of all counters, of one instant."""
        values = codec.parse_f64(self.bus.get(keys.state_counters(ROBOT)) or b"").tolist()
        return dict(zip(robot_streams.COUNTERS, values, strict=False))

    def counter(self, name: str) -> float:
        """The newest value of a counter."""
        return self.counters()[name]

    def controller(self) -> dict[str, Any]:
        """What the controller last said of itself."""
        return dict(codec.parse_json(self.bus.get(keys.state_controller(ROBOT)) or b"{}"))

    def wait_for_rest(self) -> None:
        """Wait until the controller says that the arm stands, in a word of later than now (it has ten a second)."""
        key = keys.state_controller(ROBOT)
        said = len(self.log.values(key))
        wait_until(lambda: len(self.log.values(key)) > said + 1 and not self.controller()["moving"], TIMEOUT_S)

    def settle(self) -> None:
        """Let the arm stand, armed, with nobody commanding it and nothing stopping it."""
        if self.gate()["state"] == "stopped":
            self.bus.publish({keys.ESTOP: b"0"})
        if self.gate()["state"] == "faulted":
            controller_request.ask(self.bus, ROBOT, "clear")
        arm_request.ask(self.bus, "arm", name="kassow")
        self.wait_for_gate("waiting")
        self.wait_for_rest()
        wait_until(lambda: "let go" not in self.gate()["reason"])

    def close(self) -> None:
        self.log.close()
        self.supervisor.stop_all()
        self.bus.close()
        self.server.stop()

    def __enter__(self) -> ArmStation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Commander:
    """Who commands: writes 250 times a second, from where the arm is; moves joint 1 to and fro, or holds.

    Args:
        station: Whose arm.
        name: Under which it writes.
        speed_rad_s: Of joint 1 [rad/s].
        moves: Whether it moves from the first write on.
    """

    def __init__(
        self, station: ArmStation, name: str = "commander", *, speed_rad_s: float = 0.3, moves: bool = True
    ) -> None:
        self._speed_rad_s = speed_rad_s
        self._bus = Bus(station.server.address, name=name, timeout_s=5.0)
        self.q = station.used()
        self.moves = moves
        self.longest_gap_s = 0.0  # a busy machine may keep it from writing
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        began_s = last_s = time.monotonic()
        while not self._stop.wait(0.004):
            now_s = time.monotonic()
            if self.moves:
                direction = 1.0 if int((now_s - began_s) / 2.0) % 2 == 0 else -1.0
                self.q = self.q + direction * self._speed_rad_s * min(now_s - last_s, 0.02) * np.eye(7)[0]
            self.longest_gap_s = max(self.longest_gap_s, now_s - last_s)
            last_s = now_s
            self._bus.publish({keys.action_joints(ROBOT): codec.json_vector(self.q)})

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.close()

    def __enter__(self) -> Commander:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def rate_hz(station: ArmStation, counter: str, seconds: float) -> float:
    """How fast a counter grows, by the clock of the controller's ticks: those that were heard and those missed."""

    def ticks(counters: dict[str, float]) -> float:
        return counters["tick"] + counters["missed_ticks"]

    before = station.counters()
    wait_until(lambda: ticks(station.counters()) >= ticks(before) + seconds * 250)
    after = station.counters()
    return (after[counter] - before[counter]) / (ticks(after) - ticks(before)) * 250


class Released(NamedTuple):
    """What was sent to an arm after a stop and its release, while a commander that never let go went on.

    Attributes:
        sent_hz: Targets a second [Hz].
        gap_s: For how long the commander wrote nothing, at most [s].
    """

    sent_hz: float
    gap_s: float


def stop_and_release(arm: ArmStation) -> Released:
    """Stop an arm that is commanded, and release it; one that begins anew is followed."""
    with Commander(arm) as commander:
        arm.wait_for_gate("tracking")
        arm.bus.publish({keys.ESTOP: b"1"})
        arm.wait_for_gate("stopped")
        arm.wait_for_rest()
        assert rate_hz(arm, "stream_j_sends", 0.3) == 0.0
        commander.longest_gap_s = 0.0
        arm.bus.publish({keys.ESTOP: b"0"})
        wait_until(lambda: arm.gate()["state"] != "stopped")
        released = Released(rate_hz(arm, "stream_j_sends", 0.5), commander.longest_gap_s)
    arm.settle()
    with Commander(arm):
        arm.wait_for_gate("tracking")
    return released
