"""The runbook of each device as a user runs it without hardware: a fake under the real library drives the G1."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from station import assets
from station.bus import keys
from station.episode.quality.findings import Quality
from tests.cli.running import Home
from tests.lateness import STALE_S, TooLate, Waits, in_time
from tests.main_job.station_runs import ROOT as HOUSE
from tests.servers.g1_station import LIGHT, ROBOT, Log, logged
from tests.verdicts import expect_no_worse
from tests.waiting import DEADLINE_S, wait_until

PAD = {"gamepad": "builtin:gamepad/example.json"}
SCRIPTS: dict[str, dict[str, str]] = {
    "pico": {"pico": "builtin:pico/example.json"},
    "gamepad": PAD,
    "spacemouse": {"spacemouse": "builtin:spacemouse/example.json"},
    "gello": {"gello": "builtin:gello/g1.json"} | PAD,
    "keyboard": {"keyboard": "builtin:keyboard/example.json"},
}
TRACKED = 100  # steps: two seconds
LONGEST = 2500  # steps: fifty seconds
SHARE = 0.3  # of all steps, those in which the operator was followed
PATIENT = (*LIGHT, "gate.hold_after_s=0.5", "gate.return_after_s=2.0")
"""A robot that does not leave its operator because a busy machine is late with a command."""

pytestmark = pytest.mark.timeout(240)


def sets(scripts: dict[str, str]) -> list[str]:
    settings = [*(f"{server}.fake={file}" for server, file in scripts.items()), *(f"g1.{light}" for light in PATIENT)]
    return [word for setting in settings for word in ("--set", setting)]


@pytest.mark.parametrize("device", SCRIPTS)
def test_fake_operator_drives_the_robot_and_leaves_a_sound_episode(device: str, tmp_path: Path) -> None:
    in_time(lambda: drive(device, Home(tmp_path)), rounds=3)


def drive(device: str, home: Home) -> None:
    arguments = ("--yes", "--record", "--task", device, *sets(SCRIPTS[device]))
    with Waits.watched() as waits, home.running("up", f"runbooks/g1-sim-{device}.yaml", *arguments) as station:
        station.wait_for("✓ start g1")
        with logged(home.bus) as log:
            wait_until(lambda: is_followed(log) or steps(log) > LONGEST, 2 * DEADLINE_S)
            expect_followed(log, waits)
        station.interrupt()
        code, out = station.finish()
    assert code == 0, station.text
    check = msgspec.convert(home.json("check", out.strip()), Quality)
    assert check.events["operator-engaged"] >= 1, station.text
    assert (check.falls, check.resets, check.estops) == (0, 0, 0)
    (robot,) = check.steps
    assert robot.gate_shares["tracking"] > SHARE
    expect_no_worse("usable", check, waits)


def is_followed(log: Log) -> bool:
    return tracked(log) >= max(TRACKED, 1.2 * SHARE * steps(log))


def expect_followed(log: Log, waits: Waits) -> None:
    """The robot followed for long enough; or samples came late, and until the next press nobody drives."""
    if not is_followed(log):
        waits.seconds()
        lost = [event.detail["reason"] for event in log.events("operator-disengaged", "operator-refused")]
        raise TooLate(f"{tracked(log)} of {steps(log)} steps: {lost}", STALE_S / 2, waits.longest_s)


def steps(log: Log) -> int:
    """Return how many steps the robot has made."""
    return len(log.of(keys.command_gate(ROBOT)))


def tracked(log: Log) -> int:
    """Return in how many steps the robot followed the operator."""
    return sum(b'"tracking"' in value for value in log.values(keys.command_gate(ROBOT)))


@pytest.mark.parametrize("device", SCRIPTS)
def test_runbook_names_the_fake_that_it_is_tried_with(device: str) -> None:
    text = (HOUSE / "runbooks" / f"g1-sim-{device}.yaml").read_text(encoding="utf-8")
    for server, file in SCRIPTS[device].items():
        assert f"--set {server}.fake={file}" in text
        assert assets.resolve(file).is_file()
