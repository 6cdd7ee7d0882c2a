"""The runbook of each device as a user runs it without hardware: a fake under the real library drives the G1."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from station.bus import keys
from station.episode.quality.findings import Quality
from tests.cli.running import Home
from tests.servers.g1_station import LIGHT, ROBOT, Log, logged
from tests.waiting import DEADLINE_S

PAD = {"gamepad": "builtin:gamepad/example.json"}
SCRIPTS: dict[str, dict[str, str]] = {
    "pico": {"pico": "builtin:pico/example.json"},
    "webxr": {"webxr": "builtin:webxr/example.json"},
    "gamepad": PAD,
    "spacemouse": {"spacemouse": "builtin:spacemouse/example.json"},
    "gello": {"gello": "builtin:gello/g1.json"} | PAD,
    "keyboard": {"keyboard": "builtin:keyboard/example.json"},
}


def drive(device: str, home: Home, is_over: Callable[[Log], bool], *gate: str) -> Quality:
    """Let a fake operator drive until something is so; return what `check` finds in the episode.

    Args:
        device: Whose runbook.
        home: In which it runs.
        is_over: Of everything on the bus.
        gate: Settings of the robot's gate.
    """
    fakes = [f"{server}.fake={file}" for server, file in SCRIPTS[device].items()]
    settings = [*fakes, *(f"g1.{setting}" for setting in (*LIGHT, *(f"gate.{times}" for times in gate)))]
    sets = [word for setting in settings for word in ("--set", setting)]
    arguments = ("--yes", "--record", "--task", device, *sets)
    with home.running("up", f"runbooks/g1-sim-{device}.yaml", *arguments) as station:
        station.wait_for("✓ start g1")
        with logged(home.bus) as log:
            station.wait_until(lambda: is_over(log), 2 * DEADLINE_S)
        station.interrupt()
        code, out = station.finish()
    assert code == 0, station.text
    check = msgspec.convert(home.json("check", out.strip()), Quality)
    assert check.events["operator-engaged"] >= 1, station.text
    assert (check.falls, check.resets, check.estops) == (0, 0, 0)
    return check


def steps(log: Log) -> int:
    """Return how many steps the robot has made."""
    return len(log.of(keys.command_gate(ROBOT)))


def tracked(log: Log) -> int:
    """Return in how many steps the robot followed the operator."""
    return sum(b'"tracking"' in value for value in log.values(keys.command_gate(ROBOT)))
