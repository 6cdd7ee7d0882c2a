"""The station's independent peer on a G1's wire: Amazon FAR's ``unitree_interface``, over Cyclone DDS 0.10.2.

One run is one process, as its library has one participant in each. Domain 0 is the only one that it knows: tests take
it one after the other (`tests.dds_domains`).

Run: ``python -m tests.adapters.robots.g1.dds.peer robot|client SECONDS``; the last line that it prints is JSON.
"""

from __future__ import annotations

import json
import os
import sys
import time
from typing import NoReturn

LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
JOINTS = 29


def _robot(seconds: float) -> NoReturn:
    """Publish states at 500 Hz whose joint 0 counts; count the commands that were understood."""
    import unitree_interface as far

    robot = far.create_robot("lo", far.RobotType.G1, far.MessageType.HG, dds_config=LOOPBACK)
    state = far.LowState(JOINTS)
    commands, last = 0, None
    for count in range(int(seconds * 500)):
        state.motor.q = [count / 1000.0] + [0.1] * (JOINTS - 1)
        state.imu.quat = [1.0, 0.0, 0.0, 0.0]
        state.mode_machine = 5
        robot.publish_low_state(state)
        said = robot.read_incoming_command()
        if said is not None and list(said.q_target) != last:
            last = list(said.q_target)
            commands += 1
        time.sleep(0.002)
    _end({"commands": commands, "q0": last[0] if last else 0.0, "kp0": said.kp[0] if said is not None else 0.0})


def _client(seconds: float) -> NoReturn:
    """Command a robot at 50 Hz: joint 0 counts; tell what its state was at the end."""
    import unitree_interface as far

    robot = far.create_robot("lo", far.RobotType.G1, far.MessageType.HG, dds_config=LOOPBACK)
    robot.set_control_mode(far.ControlMode.PR)
    states = set()
    end_s = time.monotonic() + seconds
    count = 0
    while time.monotonic() < end_s:
        command = robot.create_zero_command()
        command.q_target = [count / 1000.0] + [0.0] * (JOINTS - 1)
        robot.write_low_command(command)
        state = robot.read_low_state()
        states.add(tuple(state.motor.q))
        count += 1
        time.sleep(0.02)
    _end({"states": len(states), "q0": state.motor.q[0], "mode_machine": state.mode_machine, "sent": count})


def _end(outcome: dict[str, float]) -> NoReturn:
    """Say it, and end at once: as it closes, the library's ddscxx 0.10.2 now and then aborts (prevent_callbacks)."""
    sys.stdout.write(f"{json.dumps(outcome)}\n")
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    {"robot": _robot, "client": _client}[sys.argv[1]](float(sys.argv[2]))
