"""A program on a robot's network that writes down each LowCmd, and how fast the joints move: no writer, so no rival.

``python -m tests.bridges.g1_guard.wire_log INTERFACE DOMAIN FILE``
"""

from __future__ import annotations

import os
import select
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds.guard_client import MOTORS

COMMAND, STATE = 1, 2
ROW = np.dtype([
    ("at_ns", "<i8"), ("kind", "<i4"), ("is_damping", "<i4"), ("most_kp", "<f8"), ("most_speed", "<f8"),
    ("q", "<f8", MOTORS),
])  # fmt: skip
"""When it came [ns, monotonic]; of a LowCmd its stiffness [N m/rad], whether all joints are damped, and its positions;
of a LowState the speed of the fastest joint [rad/s], and its positions [rad]."""


def read(path: Path) -> NDArray[Any]:
    """Return what was written so far, read when it is looked at."""
    count = path.stat().st_size // ROW.itemsize if path.exists() else 0
    return np.memmap(path, ROW, "r", shape=(count,)) if count else np.zeros(0, ROW)


def main(interface: str, domain: str, path: str) -> None:
    from adapters.robots.g1.dds import messages, topics, types
    from adapters.robots.g1.dds.network import Network
    from adapters.robots.g1.dds.options import NetworkOptions

    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(45))
    row = np.zeros(1, ROW)
    with Network(NetworkOptions(interface=interface, domain=int(domain))) as network, Path(path).open("ab", 0) as file:
        commands = network.reader(topics.LOW_CMD, types.LowCmd, depth=64)
        states = network.reader(topics.LOW_STATE, types.LowState, depth=64)
        while not select.select([sys.stdin], [], [], 0)[0]:  # until whoever started it is gone
            commands.wait(0.05)
            at_ns = time.monotonic_ns()
            for message in commands.take():
                command = messages.command(message)
                assert command is not None
                motors = command["motors"][0, :MOTORS]
                row["at_ns"], row["kind"], row["is_damping"] = at_ns, COMMAND, (motors["kd"] == 8.0).all()
                row["most_kp"], row["most_speed"], row["q"][0] = motors["kp"].max(), 0.0, motors["q"]
                file.write(row.tobytes())
            for state in messages.states(states.take()):
                motors = state["motors"][:MOTORS]
                row["at_ns"], row["kind"], row["is_damping"] = at_ns, STATE, 0
                row["most_kp"], row["most_speed"], row["q"][0] = 0.0, np.abs(motors["dq"]).max(), motors["q"]
                file.write(row.tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
