"""A G1 as it is deployed: the robot's computer and the operator's PC, each on its own network, and a cable between.

On the robot's side run the twin, the guard and a log of what is on the wire; on the operator's side the robot's server.
Each side has a bus of its own on a unix socket, which a test hears without the cable.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.policies.default_pose import DefaultPosePolicy
from station import Station, assets
from station.bus import keys
from station.bus.client import Bus
from station.errors import Refused
from tests.bridges.g1_guard import wire_log
from tests.cli.running import Home, Running, new_home
from tests.network_link.link import INTERFACE, End, Link
from tests.waiting import wait_until

ROBOT_ADDRESS, OPERATOR_ADDRESS = "192.168.123.164", "192.168.123.222"
GUARD_PORT = 47029
DOMAIN = 0  # a robot's; each cable is a network of its own
FASTEST_RAD_S = 3.0
"""Of any joint, from the moment in which the cable is pulled (R10)."""
ATTEMPTS = 3
"""A busy machine silences a line as well."""

_READY_S = 40.0
_RECENT_NS = 2_000_000_000
_NEAR_RAD, _FAR_RAD = 0.1, 0.25  # it sags by 0.04 in its pose, and hangs up to 0.4 from it


class Deployment:
    """Twin, guard and robot server at the ends of a cable.

    Args:
        link: The cable; its first end is the robot's computer.
        robot_home, operator_home: Where the station's commands run at each end.
        folder: For logs.
        stack: Ends what runs.

    Attributes:
        robot, operator: The ends.
        guard: The guard's process; None where there is none.
        server: The robot's server.
    """

    def __init__(self, link: Link, robot_home: Home, operator_home: Home, folder: Path, stack: ExitStack) -> None:
        self.link, self.robot_home, self.operator_home = link, robot_home, operator_home
        self.robot, self.operator = link.ends
        self._folder, self._stack = folder, stack
        for home in (robot_home, operator_home):
            stack.enter_context(home.running("bus", "start"))
            wait_until(home.bus_is_there)
        self.guard: subprocess.Popen[bytes] | None = None
        self.server: Running | None = None
        self._pose = DefaultPosePolicy(assets.resolve(DefaultPosePolicy.CHECKPOINT)).spec.default_q

    def start_twin(self, *options: str) -> None:
        """Start the twin, let go by its own controller, and the log."""
        mine = (f"options.interface={INTERFACE}", f"options.domain={DOMAIN}", "options.is_released=true", *options)
        words = [word for each in mine for word in ("--set", each)]
        running = self._stack.enter_context(self.robot_home.running("robot-twin", "g1", *words))
        running.wait_until(lambda: "is_stiff" in self.twin())
        self._log = self._folder / "wire.rows"
        program = [sys.executable, "-m", wire_log.__name__, INTERFACE, str(DOMAIN), str(self._log)]
        log = self._stack.enter_context(self.robot.popen(program, stdin=subprocess.PIPE))
        self._stack.callback(log.kill)
        wait_until(lambda: len(wire_log.read(self._log)) > 0 or log.poll() is not None)
        assert log.poll() is None

    def start_guard(self, program: Path, end: End, address: str) -> None:
        """Start the guard at an end, listening on an address."""
        words = ["--interface", INTERFACE, "--domain", str(DOMAIN), "--bind", address, "--port", str(GUARD_PORT)]
        path = self._folder / "guard.log"
        with path.open("ab") as log:
            self.guard = guard = end.popen([str(program), *words], stderr=log)
        self._stack.callback(guard.wait)
        self._stack.callback(guard.kill)
        wait_until(lambda: b"listens on" in path.read_bytes() or guard.poll() is not None)
        assert guard.poll() is None, path.read_text()

    def start_server(self, guard: str = "") -> None:
        """Start the robot's server at the operator's end, and wait until it has the robot's states."""
        options: dict[str, Any] = {"interface": INTERFACE, "domain": DOMAIN}
        options |= {"guard": guard, "guard_port": GUARD_PORT} if guard else {}
        sets = ["robot=g1-dds", "policy=default-pose", *(f"robot_options.{key}={options[key]}" for key in options)]
        words = [word for each in sets for word in ("--set", each)]
        self.server = self._stack.enter_context(self.operator_home.running("serve", "robot", *words))
        self.server.wait_until(lambda: isinstance(self.seen().get("why_not_arm"), str))

    def seen(self) -> dict[str, Any]:
        """Return what the robot's server tells of the robot; nothing while it does not run."""
        health = self.operator_home.health().get("robot")
        return health.detail if health is not None and health.state == "active" and health.is_alive else {}

    def twin(self) -> dict[str, Any]:
        """Return how the robot is, heard on its own bus."""
        health = self.robot_home.health().get("robot-twin")
        return {} if health is None else health.detail

    def wire(self, kind: int, since_ns: int = 0) -> NDArray[Any]:
        """Return the rows of the log of one kind, since a time [ns, monotonic]."""
        rows = wire_log.read(self._log)
        rows = rows[np.searchsorted(rows["at_ns"], since_ns) :]
        found: NDArray[Any] = np.array(rows[rows["kind"] == kind])
        return found

    def wait_ready(self) -> None:
        """Wait until nothing is against arming."""
        try:
            wait_until(lambda: self.seen().get("why_not_arm") == "", _READY_S)
        except AssertionError:
            raise AssertionError(f"seen: {self.seen()}; twin: {self.twin()}") from None

    def wait_for_the_doctor(self, words: str) -> None:
        """Wait until the operator's doctor says something: a busy machine holds back a server's heartbeat."""
        wait_until(lambda: words in self.operator_home.run("doctor").stdout)

    def arm(self) -> None:
        """Arm, and wait until the robot is at its full stiffness."""

        def is_armed() -> bool:
            self.wait_ready()
            try:
                station.arm()
            except Refused:  # by what has come up since nothing was against it
                return False
            wait_until(lambda: self.is_armed or self.seen().get("arming") == "disarmed")
            return self.is_armed

        with Station(self.operator_home.bus.url) as station:
            wait_until(is_armed)

    @contextmanager
    def arming(self) -> Iterator[None]:
        """Have the robot on its way to its pose for the length of a block: armed a moment ago, and stiff already."""
        wait_until(lambda: self.has_sunk)
        begun_ns = time.monotonic_ns()

        def is_stiff() -> bool:
            is_told = self.seen().get("arming") in {"arming", "armed"}
            return is_told and bool(self.wire(wire_log.COMMAND, begun_ns)["most_kp"].any())

        while True:
            self.wait_ready()
            with self.operator_home.running("arm") as asked:
                wait_until(lambda: is_stiff() or asked.process.poll() is not None)
                if is_stiff():  # not refused by what has come up since nothing was against it
                    yield
                    return

    @property
    def is_armed(self) -> bool:
        """Whether the server holds the robot for armed, and the robot is stiff."""
        return self.seen().get("arming") == "armed" and bool(self.twin()["is_stiff"])

    def disarm(self) -> None:
        with Station(self.operator_home.bus.url) as station:
            station.disarm()
        wait_until(lambda: not self.twin()["is_stiff"])

    def times_told(self, words: str) -> int:
        """Return how many lines of the server's log hold some words."""
        assert self.server is not None
        return sum(words in line for line in list(self.server.lines))

    def last_told(self, words: str) -> str:
        """Return the newest line of the server's log that holds some words, "" for none."""
        assert self.server is not None
        return next((line for line in reversed(list(self.server.lines)) if words in line), "")

    def first_damping_ns(self, since_ns: int) -> int:
        """Return when all joints were told to damp, the first time since a moment [ns, monotonic]; 0 for not yet."""
        rows = self.wire(wire_log.COMMAND, since_ns)
        found = rows["at_ns"][rows["is_damping"] == 1]
        return int(found[0]) if len(found) else 0

    def guard_says(self) -> dict[str, Any]:
        """Return what the guard last said, as the operator's bus has it."""
        with Bus(self.operator_home.bus, name="test") as bus:
            found: dict[str, Any] = json.loads(bus.get(keys.state("guard_unitree_g1_with_hands")) or b"{}")
            return found

    def is_armed_for(self, seconds: float) -> bool:
        """Return whether the robot stays armed for a time [s]."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            if not self.is_armed:
                return False
            time.sleep(0.05)
        return True

    @property
    def is_in_its_pose(self) -> bool:
        """Whether the robot has gone where `default-pose` wants it."""
        return self._from_pose_rad() < _NEAR_RAD

    @property
    def has_sunk(self) -> bool:
        """Whether the robot hangs so far from that pose that it has a way to go; damped it takes two seconds."""
        return self._from_pose_rad() > _FAR_RAD

    def _from_pose_rad(self) -> float:
        (newest,) = self.wire(wire_log.STATE, time.monotonic_ns() - _RECENT_NS)["q"][-1:]
        return float(np.abs(newest - self._pose).max())


@contextmanager
def deployment(folder: Path, seed: int = 0) -> Iterator[Deployment]:
    """Lay the cable, and start a bus at either end."""
    with Link((ROBOT_ADDRESS, OPERATOR_ADDRESS), port=GUARD_PORT, seed=seed) as link:
        robot, operator = link.ends
        with new_home(robot.prefix) as robot_home, new_home(operator.prefix) as operator_home, ExitStack() as stack:
            yield Deployment(link, robot_home, operator_home, folder, stack)
