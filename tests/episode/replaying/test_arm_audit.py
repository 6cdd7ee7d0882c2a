"""An arm's recorded commands through its gate again: equal to the last bit, and every change is found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from station.bus import codec, keys
from station.cli.audit import arm_story
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.replaying.arm_audit import ArmAudit, audit_arm, is_arm
from station.episode.replaying.resimulate import to_sim
from station.errors import EpisodeError
from tests.episode.arm_run import ROBOT, ArmRun
from tests.episode.synthetic import EpisodeBuilder, walk


def run(folder: Path) -> ArmRun:
    return ArmRun(EpisodeBuilder(folder, task="jog"))


def full(made: ArmRun) -> ArmRun:
    """Everything that a gate does: waiting, tracking, holding, waiting again, a far command, limits."""
    made.be_silent(0.2)
    made.move(1.0)
    made.hold(0.2)
    made.be_silent(0.2)
    made.move(0.4)
    made.be_silent(0.6)
    for _ in range(300):
        made.tick(made.arm.q + np.array([0.4, 0, 0, 0, 0, 0, -0.2]))
    for _ in range(300):
        made.tick(np.full(7, 3.0))
    made.be_silent(0.5)
    return made


def audited(made: ArmRun) -> ArmAudit:
    reader = open_episode(made.finish())
    assert is_arm(reader, ROBOT)
    return audit_arm(reader, ROBOT)


def test_an_untouched_episode_is_equal_to_the_last_bit(tmp_path: Path) -> None:
    found = audited(full(run(tmp_path)))
    assert found.is_equal, found
    assert found.followed == found.commands.compared > 1000
    assert found.targets.compared > 400
    assert (found.segments, found.incomplete) == (2, 0)


def test_commands_that_came_late_are_held_as_early_as_they_were(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.delay_s = 0.2
    full(made)
    found = audited(made)
    assert found.is_equal, found
    assert made.control.commanded.validator.refused.total() == 0
    assert found.followed > 1000


def test_a_target_that_the_session_refused_is_no_difference_and_the_one_before_holds(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.be_silent(0.1)
    made.arm.refusal = "not now"  # to be engaged
    made.move(0.1)
    made.be_silent(0.4)
    made.arm.refusal = ""
    made.arm.target_refusal = "joint 1 is out of its limits"  # from the first one on
    made.move(0.1)
    made.be_silent(0.4)
    made.arm.target_refusal = ""
    made.move(0.5)
    made.arm.target_refusal = "joint 1 is out of its limits"
    made.move(0.2)
    made.arm.target_refusal = ""
    made.move(0.5)
    found = audited(made)
    assert found.is_equal, found
    assert found.refused == 1 + (25 + 24) + 50  # 24: until the last command is too old to be followed
    assert found.targets.compared > 120


@pytest.mark.parametrize("refused", [True, False])
def test_a_target_that_changed_though_it_was_refused_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: bool
) -> None:
    made = run(tmp_path)
    write: Callable[..., None] = made.builder.write

    def forge(values: dict[str, bytes], **where: object) -> None:
        if keys.target(ROBOT) in values and made.ticks == 121:
            gate = codec.parse_json(values[keys.command_gate(ROBOT)])
            values = {**values, keys.command_gate(ROBOT): codec.json_object(gate | {"target_refused": "no" * refused})}
        write(values, **where)

    monkeypatch.setattr(made.builder, "write", forge)
    made.move(1.0)
    assert audited(made).targets.different == refused


@pytest.mark.parametrize("what", ["command", "target", "used"])
def test_any_bit_that_was_changed_is_found(tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = run(tmp_path)
    write: Callable[..., None] = made.builder.write
    key = {"command": keys.action_joints, "target": keys.target, "used": keys.command_used}[what](ROBOT)

    def forge(values: dict[str, bytes], **where: object) -> None:
        if key in values and made.ticks == 121:
            numbers = codec.parse_json_vector(values[key]) if what == "command" else codec.parse_f64(values[key])
            numbers = numbers + 1e-9 * np.eye(7)[2]
            values = {**values, key: codec.json_vector(numbers) if what == "command" else codec.f64(numbers)}
        write(values, **where)

    monkeypatch.setattr(made.builder, "write", forge)
    made.be_silent(0.2)
    made.move(1.0)
    found = audited(made)
    assert not found.is_equal
    differ = found.targets if what == "target" else found.commands
    assert differ.different >= 1
    assert differ.max_abs_difference == pytest.approx(1e-9, rel=0.01)


def test_a_command_that_is_not_in_the_file_is_counted_and_the_rest_still_derived(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = run(tmp_path)
    write: Callable[..., None] = made.builder.write

    def miss(values: dict[str, bytes], **where: object) -> None:
        if keys.action_joints(ROBOT) in values and made.ticks == 121:
            made.builder.skip(keys.action_joints(ROBOT), writer="teleop")
        else:
            write(values, **where)

    monkeypatch.setattr(made.builder, "write", miss)
    made.be_silent(0.1)
    made.move(1.0)
    found = audited(made)
    assert found.incomplete == 1
    assert found.commands.different == 0
    assert found.commands.compared > 200


def test_targets_of_which_none_can_be_derived_are_not_audited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = run(tmp_path)
    write: Callable[..., None] = made.builder.write

    def without_joints(values: dict[str, bytes], **where: object) -> None:
        write({key: value for key, value in values.items() if key != keys.state_joints(ROBOT)}, **where)

    monkeypatch.setattr(made.builder, "write", without_joints)
    made.be_silent(0.1)
    made.move(0.4)
    found = audited(made)
    assert (found.targets.compared, found.targets.different) == (0, 0)
    assert not found.is_equal
    assert "targets       NOT AUDITED" in arm_story(found)


def test_an_episode_that_does_not_say_how_commands_were_limited_cannot_be_audited(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.move(0.2)
    reader = open_episode(made.builder.finish())
    with pytest.raises(EpisodeError, match="does not say how commands"):
        audit_arm(reader, ROBOT)


def test_an_episode_of_a_humanoid_has_no_arm(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.2)
    reader = open_episode(builder.finish())
    assert steps.robots(reader.topics())
    assert not any(is_arm(reader, robot) for robot in steps.robots(reader.topics()))


def test_an_arm_is_not_simulated_again_and_a_line_says_what_to_do_instead(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.move(0.2)
    folder = made.finish()
    manifest = folder / "manifest.yaml"
    manifest.write_text(manifest.read_text().replace("role: low-level", "role: low-level\n    config: {}"))
    reader: EpisodeReader = open_episode(folder)
    with pytest.raises(EpisodeError, match="station audit"):
        to_sim(reader)
