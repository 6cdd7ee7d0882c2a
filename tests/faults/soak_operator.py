"""``python -m tests.faults.soak_operator --minutes 5``: an operator at work, with all that goes wrong meanwhile.

A fake headset engages and lets go over and over, waves, walks by the sticks; three times its signal is lost, once the
PC service dies, once its library takes the device server down. A line of JSON tells what came of it; the exit code is 0
when the robot stood, no engaging jumped, and the episode that the operator recorded passes the check.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from station.bus import codec, keys
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.life.gate import GateConfig
from station.rotations import tilt
from tests.servers.g1_station import ROBOT
from tests.servers.operated_station import OperatedStation
from tests.waiting import wait_until

CYCLE_S, HELD_S = 5.4, 3.4
FIRST_S = 4.0
FAULTS = ("silence", "silence", "silence", "crash", "poison")
SAME = 1e-6
_SILENCE_S = 1.5
_STICKS: tuple[dict[str, float], ...] = (
    {}, {"left_stick_y": 0.8}, {"left_stick_y": -0.6}, {"right_stick_x": 0.7}, {"left_stick_x": 0.7},
    {"left_stick_y": 0.6, "right_stick_x": -0.5}, {"left_trigger": 1.0}, {"right_stick_y": -0.6},
    {"right_stick_y": 0.6},
)  # fmt: skip


def script(minutes: float) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return controls and faults of a session; the last thing is that the operator leaves."""
    end_s = FIRST_S + 60.0 * minutes
    controls: list[dict[str, Any]] = [
        {"at_s": 1.0, "press": "left_secondary"},
        {"at_s": 2.5, "press": "right_stick_click"},  # the sticks walk
    ]
    cycles = int((end_s - FIRST_S) / CYCLE_S)
    for cycle in range(cycles):
        at_s = FIRST_S + cycle * CYCLE_S
        controls.append({"at_s": at_s, "set": {"left_grip": 1.0}, "for_s": HELD_S})
        if sticks := _STICKS[cycle % len(_STICKS)]:
            controls.append({"at_s": at_s + 0.6, "set": sticks, "for_s": 2.0})
    controls += [
        {"at_s": end_s + 2.0, "press": "left_secondary"},
        {"at_s": end_s + 4.0, "press": "left_primary"},
    ]
    every = max(cycles // (len(FAULTS) + 1), 1)
    faults = [
        {"at_s": FIRST_S + (number + 1) * every * CYCLE_S + 1.5, "kind": kind}
        | ({} if kind == "poison" else {"for_s": _SILENCE_S})
        for number, kind in enumerate(FAULTS)
    ]
    return sorted(controls, key=lambda control: float(control["at_s"])), faults


def soak(minutes: float, folder: Path, driver: str) -> dict[str, Any]:
    """Run a session; return the figures."""
    controls, faults = script(minutes)
    bound = folder / "buttons.yaml"
    bound.write_text("engage: left_grip\n")
    with OperatedStation(
        folder, controls, faults, record=True, gate=GateConfig(), driver=driver, buttons=bound, task="soak"
    ) as station:
        process = station.supervisor.children["teleop"].process
        wait_until(lambda: process.poll() is not None, 60.0 * minutes + 120.0)
        wait_until(lambda: station.told("record-stop"))
        (episode,) = (station.data / "soak").iterdir()
        quality = check(open_episode(episode))
        poses = [codec.parse_f64(value) for value in station.log.values(keys.sim_qpos(ROBOT))]
        reasons = [event.detail["reason"] for event in station.told("operator-disengaged")]
        jumps = station.restarts_at_engaging()
        return {
            "driver": driver,
            "minutes": minutes,
            "exit_code": process.returncode,
            "engaged": len(station.told("operator-engaged")),
            "disengaged": len(reasons),
            "not_by_the_operator": [reason for reason in reasons if reason != "released"],
            "device_server_restarts": len(station.told("server-restarted")),
            "commands_ended": [event.detail["reason"] for event in station.told("teleop-commands-end")],
            "largest_jump_at_engaging": max(jumps),
            "worst_lean_deg": round(math.degrees(max(float(tilt(pose[3:7])) for pose in poses)), 1),
            "lowest_pelvis_m": round(min(float(pose[2]) for pose in poses), 3),
            "is_upright": station.is_upright(),
            "verdict": quality.verdict,
            "reasons": [reason.text for reason in quality.reasons],
        }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; return 0 when all held."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.soak_operator", description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--driver", default="hands")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        os.chmod(name, 0o700)
        found = soak(options.minutes, Path(name), options.driver)
    sys.stdout.write(json.dumps(found) + "\n")
    is_sound = (found["is_upright"], found["verdict"] != "reject", found["exit_code"] == 0)
    return int(not all(is_sound) or found["largest_jump_at_engaging"] > SAME)


if __name__ == "__main__":
    sys.exit(main())
