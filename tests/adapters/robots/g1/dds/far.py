"""Our side of what the tests do with the independent peer (`peer.py`)."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from adapters.robots.g1.dds import messages, types
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import NetworkOptions
from tests.dds_domains import domain

NEEDED = "needs far-unitree-sdk, which has no wheel for this Python"


@contextmanager
def running(role: str, seconds: float) -> Iterator[subprocess.Popen]:
    """The other program, in a process of its own, the only one on domain 0 of this machine but for the test."""
    pytest.importorskip("unitree_interface", reason=NEEDED)
    command = [sys.executable, "-m", "tests.adapters.robots.g1.dds.peer", role, str(seconds)]
    with domain(0):
        child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            yield child
        finally:
            child.kill()
            child.communicate()


def outcome(child: subprocess.Popen) -> dict[str, float]:
    said, _ = child.communicate(timeout=60)
    assert child.returncode == 0, f"it died with {child.returncode}"
    return json.loads(said.splitlines()[-1])


def command_its_robot(seconds: float) -> tuple[dict[str, float], int, int]:
    """Drive the other program's robot; return what it says, how many states came, and how many were damaged."""
    with running("robot", seconds) as child, Network(NetworkOptions()) as network:
        reader = network.reader("rt/lowstate", types.LowState, depth=512)
        writer = network.writer("rt/lowcmd", raw(types.LowCmd))
        command, came, damaged, sent = messages.new_command(), 0, 0, 0
        messages.set_modes(command, np.ones(29, np.uint8))
        command["motors"]["kp"][0, :29] = 40.0
        while child.poll() is None:
            if said := reader.take():
                came += len(said)
                damaged += sum(not messages.is_intact(each) for each in said)
                newest = messages.states([said[-1]])[0]
                command["mode_machine"] = newest["mode_machine"]
                sent += 1
                command["motors"]["q"][0, 0] = sent
                writer.write(messages.signed(command))
            time.sleep(0.02)
        return outcome(child), came, damaged


def be_its_robot(seconds: float) -> tuple[dict[str, float], int, int]:
    """Be the robot of the other program; return what it says, how many commands came, and how many were damaged."""
    with running("client", seconds) as child, Network(NetworkOptions()) as network:
        reader = network.reader("rt/lowcmd", types.LowCmd, depth=512)
        writer = network.writer("rt/lowstate", raw(types.LowState))
        state, came, damaged = messages.new_state(), 0, 0
        state["mode_machine"] = 5
        while child.poll() is None:
            state["tick"] += 2
            state["motors"]["q"][0, 0] = state["tick"][0] / 1000.0
            writer.write(messages.signed(state))
            said = reader.take()
            came += len(said)
            damaged += sum(not messages.is_intact(each) for each in said)
            time.sleep(0.002)
        return outcome(child), came, damaged
