"""A history by seed: who commands dies, freezes and comes back, lines are cut, the bus restarts, operators stop."""

from __future__ import annotations

import contextlib
import itertools
import logging
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from station.bus import codec, keys, stamp
from station.bus.connection import Connection
from station.control.gate import GateConfig
from station.errors import BusError
from station.life import estop
from station.life.stop_button import StopButton
from tests.virtual.clock import VirtualClock
from tests.virtual.judge import Bus, Judge
from tests.virtual.network import Network
from tests.virtual.station import COMMANDERS, FORMAT, Commander, ControlledRobot, Walk, ask, commander, request_to

SETTLED_S = 0.6
"""After a disturbance is over: so long until the robot's server hears everything again [s]."""

MEMORY = Path("/dev/shm")
"""Where a sync takes no time, on Linux: every stop is synced to its file."""


class Trial:
    """One history.

    Args:
        seed: Decides all of it.
        lasts_s: How long it goes on before all is set right again [s].

    Attributes:
        story: What was done, with its instant, for the report of a failure.
    """

    def __init__(self, seed: int, lasts_s: float = 2.0) -> None:
        self._seed, self._lasts_s = seed, lasts_s
        self.story: list[str] = []

    def play(self) -> list[str]:
        """Play it; return what does not hold."""
        with VirtualClock(self._seed, late_ns=200_000, read_ns=20) as self.clock:
            rng = self._rng = self.clock.random
            self.network = Network(self.clock, latency_ns=(10_000, 300_000), name=f"trial-{self._seed}")
            self._is_told = rng.random() > 0.05
            if not self._is_told:
                self.network.server.refused.add(b"CONFIG")
            self._has_operator = rng.random() < 0.5
            self._is_real = rng.random() < 0.4
            gate = GateConfig(rivals=rng.choice(["keep-first", "keep-first", "newest"]))
            self.robot = ControlledRobot(
                self.network, is_simulated=not self._is_real, thinks_s=(0.0005, 0.004), gate=gate
            )
            self.network.link(self.robot.process).fragments = rng.random() < 0.2
            self._disturbed: list[tuple[float, float]] = []
            self._asked_past_bus: list[float] = []
            self._commanders: list[Commander] = []
            self.clock.sleep(0.06)
            if self._is_real:
                self._arm()
            self._command()
            end_s = self.clock.monotonic_s() + self._lasts_s
            while self.clock.monotonic_s() < end_s:
                self.clock.sleep(rng.expovariate(4.0))
                rng.choice(self._actions())()
            complaints = self._set_right() if rng.random() < 0.25 else []
            bus = Bus(self.network.server.journal)
            judge = Judge(
                self.robot.ticks, bus, self._disturbed, self._asked_past_bus,
                is_told=self._is_told, is_real=self._is_real,
            )  # fmt: skip
            return [*judge.complaints(), *complaints]

    def _actions(self) -> list[Callable[[], None]]:
        commanding = [
            self._command, self._command, self._kill, self._leave, self._freeze_commander, self._freeze_commander,
            self._freeze_line, self._kill_behind_a_frozen_line, self._cut_line, self._freeze_robots_line,
            self._cut_robots_line, self._freeze_bus, self._restart_bus, self._freeze_robot, self._garbage,
            self._set_wall_clock, self._switch_notifications_off,
        ]  # fmt: skip
        operating = [
            self._press, self._stop, self._overwritten_stop, self._release, self._release, self._release_in_a_pause,
            self._release_in_a_pause, self._release_button, self._stop_past_the_bus, self._arm, self._arm, self._disarm,
        ]  # fmt: skip
        return [*commanding, *operating] if self._has_operator else commanding

    def _tell(self, what: str) -> None:
        self.story.append(f"{self.clock.monotonic_s():.4f} {what}")

    def _disturb(self, what: str, seconds: float) -> None:
        self._tell(f"{what} for {seconds:.3f} s")
        now_s = self.clock.monotonic_s()
        self._disturbed.append((now_s, now_s + seconds + SETTLED_S))

    # -- who commands ------------------------------------------------------------------------------------------------
    def _command(self) -> None:
        what = self._rng.choice(list(COMMANDERS))
        walk = Walk(self._rng.uniform(-1.0, 1.0), self._rng.uniform(0.0, 0.4))
        name = f"{what}-{len(self._commanders)}"
        self._tell(f"{name} begins")
        self._commanders.append(commander(self.network, name, what, walk))
        self.network.link(self._commanders[-1].process).fragments = self._rng.random() < 0.1

    def _one(self) -> Commander | None:
        alive = [found for found in self._commanders if self.clock.is_running(found.process)]
        return self._rng.choice(alive) if alive else None

    def _kill(self) -> None:
        if (found := self._one()) is not None:
            self._tell(f"{found.process.name} is killed")
            self.clock.kill(found.process)

    def _leave(self) -> None:
        if (found := self._one()) is not None:
            self._tell(f"{found.process.name} is asked to leave")
            found.leave()

    def _freeze_commander(self) -> None:
        if (found := self._one()) is not None:
            seconds = self._rng.choice([0.05, 0.11, 0.2, 0.29, 0.31, 0.5, 1.0]) * self._rng.uniform(0.9, 1.1)
            self._tell(f"{found.process.name} is frozen for {seconds:.3f} s")
            self.clock.freeze(found.process, seconds)

    def _freeze_line(self) -> None:
        if (found := self._one()) is not None:
            seconds = self._rng.choice([0.05, 0.15, 0.24, 0.26, 0.4, 1.5]) * self._rng.uniform(0.9, 1.1)
            self._tell(f"the line of {found.process.name} is frozen for {seconds:.3f} s")
            self.network.freeze(found.process, seconds)

    def _kill_behind_a_frozen_line(self) -> None:
        """What its line still holds comes when it has been dead for a while."""
        if (found := self._one()) is not None:
            seconds = self._rng.uniform(0.2, 1.0)
            self._tell(f"{found.process.name} is killed while its line is frozen for {seconds:.3f} s")
            self.network.freeze(found.process, seconds)
            self.clock.sleep(self._rng.uniform(0.03, 0.2))
            self.clock.kill(found.process)

    def _cut_line(self) -> None:
        if (found := self._one()) is not None:
            self._tell(f"the line of {found.process.name} is cut")
            self.network.cut(found.process)

    def _garbage(self) -> None:
        value = self._rng.choice([b"", b"nonsense", b"[1e400]", b"[" + b"9" * 400 + b"]", codec.json_vector([0.0] * 3)])
        self._raw("garbage", ["SET", FORMAT.key, value])

    # -- what happens to bus and robot -------------------------------------------------------------------------------
    def _freeze_robots_line(self) -> None:
        seconds = self._rng.choice([0.02, 0.09, 0.3, 1.0])
        self._disturb("the robot's line is frozen", seconds)
        self.network.freeze(self.robot.process, seconds)

    def _cut_robots_line(self) -> None:
        self._disturb("the robot's line is cut", 0.0)
        self.network.cut(self.robot.process)

    def _freeze_bus(self) -> None:
        seconds = self._rng.choice([0.03, 0.1, 0.3, 0.8])
        self._disturb("the bus is frozen", seconds)
        self.network.freeze_server(seconds)

    def _restart_bus(self) -> None:
        seconds = self._rng.choice([0.0, 0.03, 0.3])
        self._disturb("the bus is restarted, down", seconds)
        self.network.restart_server(seconds)

    def _freeze_robot(self) -> None:
        seconds = self._rng.choice([0.03, 0.12, 0.4])
        self._disturb("the robot's server is frozen", seconds)
        self.clock.freeze(self.robot.process, seconds)

    def _switch_notifications_off(self) -> None:
        if self._is_told:
            self._disturb("notifications are switched off", 0.06)
            self._raw("", ["CONFIG", "SET", "notify-keyspace-events", "Ex"])

    def _set_wall_clock(self) -> None:
        self._tell("the wall clock is set")
        self.clock.wall_ahead_ns += self._rng.choice([-3600, 3600]) * 1_000_000_000

    # -- operators ---------------------------------------------------------------------------------------------------
    def _raw(self, what: str, *requests: list[str | bytes]) -> None:
        """Send requests in one go, past the station's own clients."""
        if what:
            self._tell(what)

        def run() -> None:
            try:
                line = Connection(self.network.address(), timeout_s=1.0)
                line.pipeline(requests)
                line.close()
            except BusError:
                pass

        self.clock.spawn(run, "script")

    def _button(self, what: str, act: Callable[[StopButton], None]) -> None:
        self._tell(what)

        def run() -> None:
            try:
                with StopButton(self.network.address(), who="anna") as button:
                    act(button)
            except BusError:
                pass

        self.clock.spawn(run, "button")

    def _press(self) -> None:
        self._button("the stop is pressed", lambda button: button.press("trial"))

    def _release_button(self) -> None:
        self._button("the stop is released", lambda button: button.release("trial", arm=self._rng.random() < 0.5))

    def _stop(self) -> None:
        key = self._rng.choice(estop.KEYS) if self._is_told else keys.ESTOP  # polled, the same bytes again are no news
        values = [b"1", b"true", b"{", b"\xff", b'{"stop":true}', b'{"stop":1}', b"[0]", b"00"]
        if key == keys.ESTOP_PRESSED:
            values += [b"0", b"", b'{"stop":false}']
        self._raw(f"SET of a stop, {key}", ["SET", key, self._rng.choice(values)])

    def _release(self) -> None:
        self._raw("SET of a release", ["SET", keys.ESTOP, "0"])

    def _release_in_a_pause(self) -> None:
        """Release while one who commands through the stop holds its breath."""
        if (found := self._one()) is not None:
            self._tell(f"{found.process.name} pauses for 0.45 s, and the stop is released meanwhile")
            self.clock.freeze(found.process, 0.45)
            self.clock.sleep(self._rng.uniform(0.2, 0.44))
            self._release()

    def _overwritten_stop(self) -> None:
        after: list[str | bytes] = self._rng.choice([
            ["SET", keys.ESTOP, "0"], ["DEL", keys.ESTOP], ["GETDEL", keys.ESTOP], ["RENAME", keys.ESTOP, "x"],
            ["FLUSHALL"], ["MSET", keys.ESTOP, "0", "x", "1"],
        ])  # fmt: skip
        if after[0] == "DEL" and self._rng.random() < 0.5:
            self._raw("a press, and its release in the same breath", ["SET", keys.ESTOP_PRESSED, "1"],
                      ["DEL", keys.ESTOP_PRESSED], ["SET", keys.ESTOP, "0"])  # fmt: skip
            return
        self._raw(f"a stop, and {after[0]} in the same breath", ["SET", keys.ESTOP, "1"], after)

    def _stop_past_the_bus(self) -> None:
        if self.robot.life is not None:
            self._tell("the supervisor asks for a stop")
            self._asked_past_bus.append(self.clock.monotonic_s())
            self.robot.stop_past_the_bus()

    def _arm(self) -> None:
        self._tell("arm")
        ask(self.network, lambda bus: bus.publish({keys.ARM: request_to("arm")}))

    def _disarm(self) -> None:
        self._tell("disarm")
        ask(self.network, lambda bus: bus.publish({keys.ARM: request_to("disarm")}))

    # -- the end -----------------------------------------------------------------------------------------------------
    def _set_right(self) -> list[str]:
        """End all faults and all who command; a robot that is released and armed then follows a new commander."""
        for found in self._commanders:
            self.clock.kill(found.process)
        self._cut_robots_line()
        self.clock.sleep_until(max(self.network.free_ns, round(max(end_s for _, end_s in self._disturbed) * 1e9)))
        self._button("the stop is released", lambda button: button.release("the end", arm=self._is_real))
        self.clock.sleep(0.5)
        self._arm()
        self._commanders.append(commander(self.network, "last", "teleop", Walk(0.5, 0.1)))
        self._tell("the last commander begins")
        self.clock.sleep(1.2)
        newest = self.robot.newest.decision
        if newest.state != "tracking":
            return [f"at the end nothing is followed: {msgspec.to_builtins(newest.state)}, {newest.reason}"]
        return []


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Give a trial a state folder of its own, and names that are the same in each run."""
    numbers = itertools.count()
    with (
        tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("XDG_STATE_HOME", folder)
        patch.setattr(stamp, "new_source", lambda name: f"{name}.1.{stamp.boot_id()}.{next(numbers):04x}")
        yield


def play(seed: int, lasts_s: float = 2.0) -> None:
    """Play a trial.

    Raises:
        AssertionError: something does not hold; with the seed and all that was done.
    """
    trial = Trial(seed, lasts_s)
    logging.disable(logging.CRITICAL)
    try:
        with alone():
            complaints = trial.play()
    except BaseException as error:
        error.add_note("\n".join([f"seed {seed}", *trial.story]))
        raise
    finally:
        logging.disable(logging.NOTSET)
    if complaints:
        raise AssertionError("\n".join([f"seed {seed}", *complaints[:10], "", *trial.story]))
