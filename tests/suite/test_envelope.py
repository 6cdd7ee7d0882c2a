"""A policy's envelope is measured of motions and keeps the robot on its feet under wild commands."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from adapters.commands.twist2 import FORMAT
from adapters.robots.g1.joints import G1_29
from station import registry
from station.cli.main import cli
from station.control.envelope import read
from station.control.rig import build
from station.rehearse import rehearse
from station.suite import attacks
from station.suite.attacks import ATTACKS, Attack
from station.suite.cases import Attacked
from station.suite.promise import FULL, QUICK, velocity_cases
from station.suite.trial import run_case
from tests.suite.made import TRACKER, limp_network

FREE = msgspec.structs.replace(TRACKER, envelope="none")
CLIPS = ("builtin:walk-forward", "builtin:squat")


def attacked(attack: Attack, seed: int) -> Attacked:
    return Attacked(group="envelope", seconds=9.0, attack=attack, seed=seed, clips=CLIPS)


def test_an_attack_that_makes_the_robot_fall_does_not_within_the_envelope() -> None:
    assert run_case(attacked("jump", 0), FREE).falls
    assert run_case(attacked("edge", 3), FREE).falls
    for case in (attacked("jump", 0), attacked("edge", 3), attacked("two", 6)):
        assert run_case(case, TRACKER).falls == ()


@pytest.mark.parametrize("attack", ATTACKS)
def test_attacks_are_within_the_format_and_the_same_for_a_seed(attack: Attack) -> None:
    rig = build(TRACKER)
    motions = [registry.find("loader", "motion")(clip) for clip in CLIPS]
    for seed in range(6):
        (made, writers), (again, _) = (
            attacks.commands(attack, seed, rig.command_format, rig.envelopes, motions, seconds=2.0, period_s=0.02)
            for _ in range(2)
        )
        np.testing.assert_array_equal(made, again)
        assert made.shape == (100, 35)
        assert len(writers) == 100
        assert (set(writers) == {"a", "b"}) == (attack == "two")
        if attack not in ("frames", "mixed", "two"):  # a motion may be beyond: the validator clamps it
            assert (made >= rig.command_format.lower).all()
            assert (made <= rig.command_format.upper).all()
    rig.robot.close()


def test_the_suite_attacks_by_all_kinds_in_turn() -> None:
    found = [case for case in velocity_cases(QUICK, np.full(3, -1.0), np.ones(3)) if isinstance(case, Attacked)]
    assert {case.attack for case in found} == set(ATTACKS) - {"frames"}
    assert len({case.name for case in found}) == QUICK.attacks < FULL.attacks


def test_an_envelope_is_measured_written_read_and_lets_its_motions_pass_to_the_last_bit(tmp_path: Path) -> None:
    file = tmp_path / "mine.envelope.yaml"
    words = ["rehearse", "builtin:bow", "builtin:wave", "--envelope", str(file), "--jobs", "1"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    assert f"saved {file}: 29 elements of the command, from 2 motions" in done.output
    assert "# builtin:bow" in file.read_text()
    made = read(file)
    assert "left_wrist_roll_pos" not in made.elements
    rig = build(msgspec.structs.replace(TRACKER, envelope=str(file)))
    for name in ("builtin:bow", "builtin:wave", "builtin:walk-forward"):
        beyond = 0

        def count(_: object, record: object) -> None:
            nonlocal beyond
            beyond += bool(record.decision.beyond)  # type: ignore[attr-defined]

        rehearse(
            registry.find("loader", "motion")(name), rig.policy, rig.robot, rig.command_format, envelopes=rig.envelopes,
            on_step=count,
        )  # fmt: skip
        assert (beyond > 0) == (name == "builtin:walk-forward"), name
    rig.robot.close()


def test_motions_that_are_not_survived_are_left_out_and_without_any_nothing_is_written(tmp_path: Path) -> None:
    limp, file = limp_network(tmp_path / "limp.onnx"), tmp_path / "limp.envelope.yaml"
    words = ["rehearse", "builtin:wave", "--checkpoint", str(limp), "--envelope", str(file), "--jobs", "1"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code != 0
    assert "no motion was tracked without a fall" in f"{done.output}{done.exception}"
    assert not file.exists()


def test_a_hole_in_a_motion_is_bridged_when_asked_and_else_refused(tmp_path: Path) -> None:
    height, holed, file = np.full(100, 0.78), tmp_path / "holed.npz", tmp_path / "mine.envelope.yaml"
    height[50:53] += 1.0
    np.savez(
        holed, fps=50.0, root_pos=np.column_stack([np.zeros((100, 2)), height]), joint_names=G1_29,
        root_quat_wxyz=np.tile([1.0, 0, 0, 0], (100, 1)), joint_pos=np.tile(FORMAT.default[6:], (100, 1)),
    )  # fmt: skip
    words = ["rehearse", str(holed), "--envelope", str(file), "--jobs", "1"]
    assert CliRunner().invoke(cli, words).exit_code != 0
    assert not file.exists()
    done = CliRunner().invoke(cli, [*words, "--holes", "bridge"])
    assert done.exit_code == 0, done.output
    assert file.exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--suite", "--envelope", "x.yaml"], "--envelope goes with MOTIONS"),
        (["builtin:bow", "--envelope", "nowhere/x.yaml"], "no folder nowhere"),
        (["builtin:bow", "--envelope", "x.yaml", "--policy", "g1-walk"], "policy 'g1-walk' follows velocities"),
    ],
)
def test_what_does_not_go_together_is_refused_in_a_line(words: list[str], told: str) -> None:
    done = CliRunner().invoke(cli, ["rehearse", *words])
    assert done.exit_code != 0
    assert told in f"{done.output}{done.exception}"
