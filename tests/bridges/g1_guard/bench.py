"""A guard in a process, a robot on its DDS network that keeps what it is sent, and a client on its UDP port."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from adapters.robots.g1.dds.guard_client import MOTORS, GuardClient, GuardStatus, Reason, State
from tests.dds_domains import domain
from tests.waiting import wait_until

Q, KP, KD = np.full(MOTORS, 0.1), np.full(MOTORS, 40.0), np.full(MOTORS, 2.0)
"""What a station commands here."""

MACHINE_WAS_LATE = {Reason.NO_STATE, Reason.TICK, Reason.SILENCE, Reason.LATE}
"""Reasons that a busy machine gives as well: whoever did not ask for one of them tries again."""


class Received(NamedTuple):
    """A LowCmd, and when it came [ns, monotonic]."""

    at_ns: int
    record: Any
    is_intact: bool

    @property
    def kp(self) -> Any:
        return self.record["motors"]["kp"][:MOTORS]

    @property
    def kd(self) -> Any:
        return self.record["motors"]["kd"][:MOTORS]

    @property
    def q(self) -> Any:
        return self.record["motors"]["q"][:MOTORS]

    @property
    def is_damping(self) -> bool:
        return bool((self.kd == 8).all())


class FakeRobot:
    """LowStates at 500 Hz from a thread, and every LowCmd that comes.

    Attributes:
        state: The LowState that goes out next; its tick counts by itself.
        is_sending, is_ticking, is_signed: Whether LowStates go out, their tick counts, their checksum is right.
        received: LowCmds so far.
    """

    def __init__(self, number: int, before: Callable[[], None] = lambda: None) -> None:
        from adapters.robots.g1.dds import messages, types
        from adapters.robots.g1.dds.network import Network, raw
        from adapters.robots.g1.dds.options import NetworkOptions

        self._messages, self._before = messages, before
        self._network = Network(NetworkOptions(domain=number))
        self._writer = self._network.writer("rt/lowstate", raw(types.LowState))
        self._reader = self._network.reader("rt/lowcmd", raw(types.LowCmd), depth=512)
        self.is_sending = self.is_ticking = self.is_signed = True
        self.received: list[Received] = []
        self.reset()
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fake robot")
        self._thread.start()

    def reset(self) -> None:
        """Stand upright, cool and without a fault."""
        state = self._messages.new_state()
        state["mode_machine"], state["quat_wxyz"][0, 0] = 5, 1.0
        state["tick"] = self.tick if hasattr(self, "state") else 1000
        state["remote"][0, :2] = 0x55, 0x51
        self.is_sending = self.is_ticking = self.is_signed = True
        self.state = state

    @property
    def tick(self) -> int:
        return int(self.state["tick"][0])

    def _run(self) -> None:
        self._before()
        next_s = time.monotonic()
        while not self._is_over.is_set():
            state = self.state
            if self.is_ticking:
                state["tick"] += 2
            if self.is_sending:
                message = self._messages.signed(state)
                self._writer.write(message if self.is_signed else message[:-1] + bytes([message[-1] ^ 1]))
            for came in self._reader.take():
                record = self._messages.command(came)
                assert record is not None
                intact = self._messages.is_intact(came)
                self.received.append(Received(time.monotonic_ns(), record[0], intact))
            next_s = max(next_s + 0.002, time.monotonic() - 0.01)
            time.sleep(max(0.0, next_s - time.monotonic()))

    def modes(self, received: Received) -> list[int]:
        return self._messages.modes(np.array([received.record]), MOTORS).tolist()

    def close(self) -> None:
        self._is_over.set()
        self._thread.join()
        self._network.close()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Bench:
    """A context manager.

    Args:
        program: The guard.
        number: DDS domain.
        folder: For what the guard says, and its flag.
        before: Called first in the robot's thread.
    """

    def __init__(self, program: Path, number: int, folder: Path, before: Callable[[], None] = lambda: None) -> None:
        self.number, self.port = number, free_port()
        self._program, self._log, self.flag = program, folder / "guard.log", folder / "armed"
        self._before = before

    def __enter__(self) -> Self:
        self.guard = self.start()
        self.robot = FakeRobot(self.number, self._before)
        self.client = GuardClient(port=self.port)
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        self.robot.close()
        self.guard.kill()
        self.guard.wait()

    def start(self) -> subprocess.Popen[bytes]:
        """Start a guard and wait until it listens."""
        command = [str(self._program), "--domain", str(self.number), "--port", str(self.port),
                   "--armed-flag", str(self.flag)]  # fmt: skip
        before = self._log.stat().st_size if self._log.exists() else 0
        with self._log.open("ab") as log:
            guard = subprocess.Popen(command, stderr=log, stdout=log)
        wait_until(lambda: b"listens on" in self._log.read_bytes()[before:] or guard.poll() is not None)
        assert guard.poll() is None, self.said
        return guard

    def end(self) -> None:
        """End the guard as its service does, and see that it ends well."""
        self.guard.send_signal(signal.SIGTERM)
        assert self.guard.wait(60) == 0, self.said
        assert "ERROR" not in self.said
        assert "runtime error" not in self.said

    @property
    def said(self) -> str:
        return self._log.read_text()

    def status(self) -> GuardStatus:
        """Return what the guard says now."""
        self.client.poll()  # of what was said before, by a guard that is gone too, nothing counts
        asked = time.monotonic()
        wait_until(lambda: self.client.poll() and self.client.silence_s < time.monotonic() - asked)
        assert self.client.status is not None
        return self.client.status

    def command(self, seconds: float, q: Any = Q, kp: Any = KP, kd: Any = KD) -> None:
        """Command at 50 Hz for a time."""
        for _ in range(round(seconds * 50)):
            self.client.poll()
            self.client.send(self.robot.tick, q, kp, kd)
            time.sleep(0.02)
        self.client.poll()

    def arm(self) -> None:
        """Arm, and command for 0.1 s."""
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            self.client.arm()
            while not (self.client.poll() and self.client.is_granted) and not self.client.why_not_armed:
                time.sleep(0.001)
            self.command(0.1)
            if self.client.is_armed and self.status().state is State.ARMED:
                return
        raise AssertionError(f"was not armed: {self.client.why_not_armed!r}, {self.client.status}")

    def until_damping(self, reason: Reason, act: Callable[[], None], *, commands: bool = True) -> list[Received]:
        """Arm, let something happen that ends it, and return what the robot was sent from then on."""
        for _ in range(9):
            self.arm()
            before = len(self.robot.received)
            act()
            deadline = time.monotonic() + 60
            while self.status().state is not State.DAMPING and time.monotonic() < deadline:
                self.command(0.06) if commands else time.sleep(0.02)
            status = self.status()
            assert status.state is State.DAMPING
            if status.reason is reason:
                wait_until(lambda: not self.robot.received[-1].kp.any())  # the robot hears it later than we of it
                return self.robot.received[before:]
            assert status.reason in MACHINE_WAS_LATE, status.reason
            self.robot.reset()
            time.sleep(0.2)
        raise AssertionError(f"nine times another reason than {reason!r}: {self.status().reason!r}")


class Sender:
    """A station in a process of its own, which arms and commands at 50 Hz from what the guard tells it."""

    def __init__(self, port: int, stamps: Path | None = None) -> None:
        command = [sys.executable, "-m", "tests.bridges.g1_guard.sender", str(port), *([str(stamps)] if stamps else [])]
        self._child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._child.stdout is not None

    def wait_armed(self) -> None:
        assert self._child.stdout is not None
        assert self._child.stdout.readline().strip() == "armed"

    def signal(self, which: signal.Signals) -> None:
        os.kill(self._child.pid, which)

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.signal(signal.SIGKILL)
        self._child.communicate()


@contextlib.contextmanager
def guarded(program: Path) -> Iterator[tuple[int, list[str]]]:
    """Have a guard on a domain of its own; yields that, and the settings of a twin and a robot that meet there."""
    port = free_port()
    with domain() as number, subprocess.Popen([str(program), "--domain", str(number), "--port", str(port)]) as running:
        try:
            of_robot = {"domain": number, "guard": "127.0.0.1", "guard_port": port}
            options = [f"robot.robot_options.{name}={value}" for name, value in of_robot.items()]
            yield number, [f"twin.options.domain={number}", *options]
        finally:
            running.terminate()
