"""``python -m tests.faults.soak_operator --device spacemouse --minutes 5``: an operator at work, and what goes wrong.

The device's runbook, as a user starts it, with a fake under the device's real library: it engages and lets go over and
over and moves the robot; three times its signal is lost, and once its server is killed (``kill -9``). A line of JSON
tells what came of it; the exit code is 0 when all of it happened, the robot stood, no engaging jumped, and the episode
passes the check.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import time
from collections.abc import Sequence
from typing import Any

from station.bus import codec, keys
from station.rotations import tilt
from tests.cli.running import Home, Running, new_home
from tests.faults.operator_scripts import LOSSES, SESSIONS, Plan, Session
from tests.servers.engagements import jumps_at_engaging
from tests.servers.g1_station import ROBOT, Log, logged
from tests.servers.operated_station import UPRIGHT_M
from tests.waiting import wait_until

SAME = 1e-6
_PATIENCE_S = 60.0


def soak(device: str, minutes: float) -> dict[str, Any]:
    """Run a session; return the figures."""
    plan = Plan.lasting(minutes)
    session = SESSIONS[device](plan)
    with new_home() as home:
        with home.running("up", f"g1-sim-{device}", "--yes", "--record", "--task", "soak", *_sets(home, session)) as up:
            up.wait_for("✓ start teleop")
            with logged(home.bus) as log:
                _attend(home, up, log, device, plan)
                up.interrupt()
                code, _ = up.finish()
        check = home.json("check", "latest")
        return {"device": device, "minutes": minutes, "cycles": plan.cycles, "exit_code": code, **_told(log, check)}


def _sets(home: Home, session: Session) -> list[str]:
    settings = []
    for server, script in session.scripts.items():
        file = home.data.parent / f"{server}.json"
        file.write_text(json.dumps(script))
        settings.append(f"{server}.fake={file}")
    if session.engage:
        buttons = home.data.parent / "buttons.yaml"
        buttons.write_text(f"engage: {session.engage}\nstart_pause: none\n")
        settings.append(f"teleop.buttons={buttons}")
    return [word for setting in settings for word in ("--set", setting)]


def _attend(home: Home, up: Running, log: Log, device: str, plan: Plan) -> None:
    """Kill the device's server in its cycle, and stay until the script is over."""
    began_s = time.monotonic()

    def is_in(cycle: int) -> bool:
        assert up.process.poll() is None, up.text
        has_begun = len(log.events("operator-engaged", "operator-refused")) > cycle
        return has_begun or time.monotonic() - began_s > plan.begin_s(cycle + 1)

    wait_until(lambda: is_in(plan.fatal), _PATIENCE_S + plan.end_s)
    os.kill(home.pids()[device], signal.SIGKILL)
    log.wait_for("server-restarted")
    wait_until(lambda: is_in(plan.cycles - 1), _PATIENCE_S + plan.end_s)
    wait_until(lambda: log.events("operator-engaged", "operator-disengaged")[-1].name == "operator-disengaged")


def _told(log: Log, check: dict[str, Any]) -> dict[str, Any]:
    poses = [codec.parse_f64(value) for value in log.values(keys.sim_qpos(ROBOT))]
    reasons = [str(event.detail["reason"]) for event in log.events("operator-disengaged")]
    jumps = jumps_at_engaging(log)
    return {
        "engaged": len(log.events("operator-engaged")),
        "refused": [str(event.detail.get("reason")) for event in log.events("operator-refused")],
        "not_by_the_operator": [reason for reason in reasons if reason != "released"],
        "device_server_restarts": len(log.events("server-restarted")),
        "commands_ended": [str(event.detail["reason"]) for event in log.events("teleop-commands-end")],
        "largest_jump_at_engaging": max(jumps),
        "worst_lean_deg": round(math.degrees(max(float(tilt(pose[3:7])) for pose in poses)), 1),
        "lowest_pelvis_m": round(min(float(pose[2]) for pose in poses), 3),
        "falls": check["falls"],
        "events_in_episode": {
            name: check["events"].get(name, 0)
            for name in ("operator-engaged", "operator-disengaged", "server-restarted")
        },
        "verdict": check["verdict"],
        "reasons": [reason["text"] for reason in check["reasons"]],
    }


def is_sound(found: dict[str, Any]) -> bool:
    """Whether a session held what is promised, and was driven as planned."""
    return is_safe(found) and found["engaged"] >= found["cycles"] and found["verdict"] != "reject"


def is_safe(found: dict[str, Any]) -> bool:
    """Whether nothing jumped or fell in all that went wrong, on a machine that may be late itself."""
    return (
        found["exit_code"] == 0
        and found["engaged"] + len(found["refused"]) >= found["cycles"]
        and len(found["not_by_the_operator"]) > LOSSES
        and found["device_server_restarts"] >= 1
        and found["falls"] == 0
        and found["lowest_pelvis_m"] > UPRIGHT_M
        and found["largest_jump_at_engaging"] <= SAME
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; return 0 when all held."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.soak_operator", description=__doc__)
    parser.add_argument("--device", choices=[*SESSIONS, "all"], default="all")
    parser.add_argument("--minutes", type=float, default=5.0)
    options = parser.parse_args(arguments)
    is_good = True
    for device in SESSIONS if options.device == "all" else (options.device,):
        found = soak(device, options.minutes)
        is_good &= is_sound(found)
        sys.stdout.write(json.dumps(found) + "\n")
        sys.stdout.flush()
    return int(not is_good)


if __name__ == "__main__":
    sys.exit(main())
