"""The example scripts that come with the fakes can be played."""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.devices import fakes
from adapters.devices.fakes.gamepad.pad import PadStep
from adapters.devices.fakes.gello.leader import LeaderStep, arms_of, servos_of
from adapters.devices.fakes.glove.hand import GloveStep, sides_of
from adapters.devices.fakes.keyboard.typist import TypistStep
from adapters.devices.fakes.script import Step, load
from adapters.devices.fakes.spacemouse.mouse import MouseStep

KINDS: dict[str, type[Step]] = {
    "spacemouse": MouseStep, "gello": LeaderStep, "glove": GloveStep, "gamepad": PadStep, "keyboard": TypistStep,
}  # fmt: skip
FOLDER = Path(fakes.__path__[0])


@pytest.mark.parametrize("device", KINDS)
def test_an_example_is_a_script_that_goes_round(device: str) -> None:
    assert load(FOLDER / device / "example.json", device, KINDS[device]).period_s is not None


def test_the_example_of_a_leader_has_seven_joints_and_a_gripper() -> None:
    file = FOLDER / "gello" / "example.json"
    script = load(file, "gello", LeaderStep)
    assert arms_of(script, file) == ["left"]
    assert {len(step.left) for step in script.steps if step.left is not None} == {8}


def test_the_example_of_an_so101_has_five_joints_a_gripper_and_servos_of_feetech() -> None:
    file = FOLDER / "gello" / "so101.json"
    script = load(file, "gello", LeaderStep)
    assert servos_of(script, file) == "feetech"
    assert {len(step.left) for step in script.steps if step.left is not None} == {6}


@pytest.mark.parametrize(("name", "sides"), [("example", ["left", "right"]), ("left", ["left"]), ("right", ["right"])])
def test_the_examples_of_gloves_close_and_open_a_hand(name: str, sides: list[str]) -> None:
    file = FOLDER / "glove" / f"{name}.json"
    assert sides_of(load(file, "glove", GloveStep), file) == sides
