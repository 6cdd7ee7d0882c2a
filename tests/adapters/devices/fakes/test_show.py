"""``python -m adapters.devices.fakes.DEVICE FILE``: what the adapter makes of a script, without a bus."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.waiting import DEADLINE_S

UNPLUGGED = {"at_s": 0.3, "plugged": False}
STEPS: dict[str, list[dict[str, Any]]] = {
    "spacemouse": [{"at_s": 0.1, "buttons": [1]}, UNPLUGGED],
    "gamepad": [{"at_s": 0.1, "set": {"right_primary": 1}}, UNPLUGGED],
    "keyboard": [{"at_s": 0.1, "press": "w"}, UNPLUGGED],
}
SHOWN = {"spacemouse": "button_1=1", "gamepad": "right_primary=1", "keyboard": "key_w=1"}


def command(device: str, *arguments: str) -> list[str]:
    return [sys.executable, "-m", f"adapters.devices.fakes.{device}", *arguments]


@pytest.mark.parametrize("device", STEPS)
@pytest.mark.usefixtures("processes")
def test_changes_are_shown_until_the_device_is_gone(device: str, tmp_path: Path) -> None:
    file = tmp_path / "script.json"
    file.write_text(json.dumps({"device": device, "steps": STEPS[device]}))
    ended = subprocess.run(command(device, str(file)), capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    lines = ended.stdout.splitlines()
    assert any(SHOWN[device] in line for line in lines)
    assert "gone" in lines[-1] or "was closed" in lines[-1]


@pytest.mark.parametrize("device", [*STEPS, "gello"])
@pytest.mark.usefixtures("processes")
def test_a_mistake_is_one_line_and_exit_code_two(device: str, tmp_path: Path) -> None:
    ended = subprocess.run(command(device), capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert (ended.returncode, ended.stderr) == (2, f"usage: python -m adapters.devices.fakes.{device} FILE\n")
    missing = command(device, str(tmp_path / "none.json"))
    ended = subprocess.run(missing, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert ended.returncode == 2
    assert ended.stderr.startswith("station: ")
    assert ended.stderr.count("\n") == 1
