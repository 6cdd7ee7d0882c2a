"""The runbook of each device as a user runs it without hardware: a fake under the real library drives the G1."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from station import assets
from tests.main_job.station_runs import ROOT, Terminal
from tests.servers.g1_station import LIGHT
from tests.verdicts import OF_A_BUSY_MACHINE

PAD = {"gamepad": "builtin:gamepad/example.json"}
SCRIPTS: dict[str, dict[str, str]] = {
    "pico": {"pico": "builtin:pico/example.json"},
    "gamepad": PAD,
    "spacemouse": {"spacemouse": "builtin:spacemouse/example.json"},
    "gello": {"gello": "builtin:gello/g1.json"} | PAD,
    "keyboard": {"keyboard": "builtin:keyboard/example.json"},
}

pytestmark = pytest.mark.timeout(240)


def sets(scripts: dict[str, str]) -> list[str]:
    settings = [*(f"{server}.fake={file}" for server, file in scripts.items()), *(f"g1.{light}" for light in LIGHT)]
    return [word for setting in settings for word in ("--set", setting)]


@pytest.mark.parametrize("device", SCRIPTS)
def test_fake_operator_drives_the_robot_and_leaves_a_sound_episode(device: str, tmp_path: Path) -> None:
    terminal = Terminal(tmp_path)
    done = terminal.run(
        "up", f"runbooks/g1-sim-{device}.yaml", "--yes", "--record", "--task", device, "--for", "8s",
        *sets(SCRIPTS[device]),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    check: dict[str, Any] = terminal.json("check", str(terminal.episode(device)))
    assert check["events"]["operator-engaged"] >= 1, done.stderr
    assert (check["falls"], check["resets"], check["estops"]) == (0, 0, 0)
    rejected = {reason["rule"] for reason in check["reasons"] if reason["verdict"] == "reject"}
    assert rejected <= OF_A_BUSY_MACHINE, check["reasons"]
    (robot,) = check["steps"]
    assert robot["gate_shares"]["tracking"] > 0.2


@pytest.mark.parametrize("device", SCRIPTS)
def test_runbook_names_the_fake_that_it_is_tried_with(device: str) -> None:
    text = (ROOT / "runbooks" / f"g1-sim-{device}.yaml").read_text(encoding="utf-8")
    for server, file in SCRIPTS[device].items():
        assert f"--set {server}.fake={file}" in text
        assert assets.resolve(file).is_file()
