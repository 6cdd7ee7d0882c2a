"""Pedals walk a G1 while leaders move its arms and gloves its hands, each by a server of its own, each part audited."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from station.episode.storage.manifest import load_manifest
from tests.main_job.station_runs import Terminal

PARTS = ("legs", "left_arm", "right_arm")
HANDS = ("left_hand", "right_hand")
FAKES = (
    "left_leader.fake=builtin:gello/g1.json",
    "right_leader.fake=builtin:gello/g1-right.json",
)
HOLDS_AND_LETS_GO = {
    "device": "gamepad", "period_s": 3.0,  # again and again: an operator that starts late engages with the next
    "steps": [
        {"at_s": 0.5, "set": {"left_bumper": 1, "left_stick_y": 0.5}},
        {"at_s": 2.5, "set": {"left_bumper": 0, "left_stick_y": 0}},
    ],
}  # fmt: skip
FALCON = ("robot.checkpoint=zoo:policies/falcon_g1_29dof.onnx",)
COCKPIT = (
    "robot.policy_options.legs=g1-walk", "robot.checkpoint=builtin:g1-walk.onnx", "legs.options.format=velocity",
    *(f"{side}_glove.fake=builtin:glove/example.json" for side in ("left", "right")),
)  # fmt: skip

pytestmark = pytest.mark.timeout(300)


@pytest.mark.parametrize(
    ("runbook", "robot", "parts", "more"),
    [
        pytest.param("g1-falcon-sim", "g1_29", PARTS, FALCON, marks=pytest.mark.assets),
        ("g1-cockpit-sim", "g1_dex3", (*PARTS, *HANDS), COCKPIT),
    ],
)
def test_it_walks_with_moving_arms_and_every_part_of_its_episode_is_audited(
    tmp_path: Path, processes: None, runbook: str, robot: str, parts: tuple[str, ...], more: tuple[str, ...]
) -> None:
    terminal, script = Terminal(tmp_path), tmp_path / "gamepad.json"
    script.write_text(json.dumps(HOLDS_AND_LETS_GO))
    sets = [word for setting in (f"gamepad.fake={script}", *FAKES, *more) for word in ("--set", setting)]
    done = terminal.run("up", runbook, "--yes", "--record", "--task", "carry", "--for", "6s", *sets)
    assert done.returncode == 0, done.stdout + done.stderr
    episode = str(terminal.episode("carry"))
    check, audit = terminal.json("check", episode), terminal.json("audit", episode)
    engaged = {event.source for event in load_manifest(Path(episode)).events if event.name == "operator-engaged"}
    assert (check["falls"], engaged) == (0, set(parts)), done.stdout
    assert set(audit["parts"]) == set(parts)
    for name, part in audit["parts"].items():
        assert (part["compared"] > 100, part["different"]) == (True, 0), name
    assert (audit["different"], audit["commands"]["different"], audit["targets"]["different"]) == (0, 0, 0)
    keys = {stream["key"]: stream["count"] for stream in check["streams"]}
    for name in parts:
        assert keys[f"command_timing_{robot}_{name}"] == keys[f"command_used_{robot}_{name}"] == audit["steps"]


@pytest.mark.parametrize(
    ("runbook", "origin"),
    [
        ("g1-homie-sim", "InternRobotics/OpenHomie on GitHub (CC BY-NC-SA 4.0, no commercial use)"),
        ("g1-falcon-sim", "LeCAR-Lab/FALCON on GitHub (MIT), sim2real/models/falcon/g1_29dof.onnx"),
    ],
)
def test_whoever_lacks_the_file_is_told_where_it_comes_from(
    tmp_path: Path, processes: None, runbook: str, origin: str
) -> None:
    done = Terminal(tmp_path).run("up", runbook, "--yes")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert "it is not part of the station: take it from" in line
    assert origin in line
