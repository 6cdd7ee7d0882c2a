"""A robot whose legs and arms are commanded apart: every part's command is recorded and goes through its gate again,
bit for bit, whatever becomes of it on its way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from station.bus import codec, keys
from station.bus.stamp import boot_id
from station.cli.audit import story
from station.control.command_validator import CommandSample
from station.control.low_level import result_values
from station.control.rig import Rig, build
from station.control.robot_server import RobotConfig, facts
from station.episode.reading.reader import open_episode
from station.episode.replaying.audit import Audit, audit
from station.episode.replaying.in_short import audit_in_short
from station.parts import parts_of
from tests.adapters.policies.velocity_inputs import onnx_file
from tests.episode.replaying.test_gate_audit import Forger, nudged
from tests.episode.synthetic import MONO_START_NS, EpisodeBuilder

ROBOT, PERIOD_NS = "g1_29", 20_000_000
PARTS = ("legs", "left_arm", "right_arm")


class PartsRun:
    """Writers of three parts that fall silent at random, and the steps of a robot, as its server makes them.

    The network has weights near zero, so the robot sags; what decides is recorded all the same.
    """

    def __init__(self, builder: EpisodeBuilder, network: Path, seed: int = 1) -> None:
        self.builder, self._random = builder, Random(seed)
        self.config = RobotConfig(
            robot="g1-mujoco", robot_options={"physics_dt_s": 0.002}, policy="g1-arms", checkpoint=str(network)
        )
        self.rig: Rig = build(self.config.rig)
        self.control = self.rig.control(gate=self.config.gate)
        self.held: list[CommandSample | None] = [None] * 3
        self._speaks, self._tick = [False] * 3, 0
        self.is_released = False  # between reading the state and the step, as a server obeys

    def steps(self, count: int, *, is_recorded: bool = True) -> None:
        for _ in range(count):
            self._step(is_recorded)

    def _step(self, is_recorded: bool) -> None:
        begins_ns = MONO_START_NS + 100_000_000 + self._tick * PERIOD_NS
        at_s = (begins_ns - MONO_START_NS) * 1e-9
        for index, part in enumerate(parts_of(self.rig.command_format)):
            self._speaks[index] ^= self._random.random() < (0.02 if self._speaks[index] else 0.1)
            if not self._speaks[index]:
                continue
            data = codec.json_vector(np.clip(self._asked(index, len(part.default)), part.lower, part.upper))
            seq = self.builder.written(part.key, writer=PARTS[index]) + 1
            written_ns = begins_ns + self._random.randrange(100_000, 900_000)
            where = {"at_s": (written_ns - MONO_START_NS) * 1e-9, "writer": PARTS[index]}
            self.builder.write({part.key: data}, **where)
            arrived_ns = written_ns + 300_000
            source = f"{PARTS[index]}.100.{boot_id()}.beef"
            self.held[index] = CommandSample(data, arrived_ns * 1e-9, 0.0003, written_ns, arrived_ns, seq, source)
        state = self.control.sense()
        before = self.rig.state_values(state)
        if self.is_released:
            self.control.reset("released")
            self.is_released = False
        now_ns = begins_ns + 4_000_000 + self._random.randrange(400_000)
        record = self.control.step(state, tuple(self.held), now_ns * 1e-9)
        done = result_values(ROBOT, record, self.control.commanded)
        self._tick += 1
        if is_recorded:
            self.builder.write(before, at_s=at_s + 0.002)
            self.builder.write(done, at_s=at_s + 0.006)
            for told in record.step_events:
                if told.name in ("operator-reset", "robot-reset"):
                    self.builder.event(told.name, at_s=at_s + 0.0061)
            return
        for key in (*before, *done):
            self.builder.skip(key)

    def _asked(self, index: int, size: int) -> np.ndarray:
        if index == 0:
            return np.array([0.3, 0.1, -0.2, 0.6])
        return 0.4 * np.sin(0.03 * self._tick + np.arange(size))

    def audited(self) -> Audit:
        self.rig.robot.close()
        self.folder = self.builder.finish({"servers": {"robot": facts(self.config, "robot", self.rig)}})
        return audit(open_episode(self.folder))


@pytest.fixture
def network(tmp_path: Path) -> Path:
    return onnx_file(tmp_path / "legs.onnx", 456, 12, scale=1e-4)


def test_every_part_s_command_is_followed_through_its_gate_to_the_last_bit(tmp_path: Path, network: Path) -> None:
    run = PartsRun(EpisodeBuilder(tmp_path), network)
    run.steps(400)
    found = run.audited()
    assert (found.commands_not_proven, found.commands.different, found.gates_different) == ({}, 0, 0)
    assert {name: (one.compared, one.different) for name, one in found.parts.items()} == dict.fromkeys(PARTS, (400, 0))
    assert found.commands.compared == 1600, "three parts, and what the policy got of them"
    assert (found.different, found.observations.different, found.targets.different) == (0, 0, 0)
    assert found.is_equal
    assert "    left_arm    400 steps, 0 different" in story(found)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("forge", [nudged], ids=["last bit"])
def test_one_bit_of_one_part_s_used_command_is_found(
    tmp_path: Path, network: Path, part: str, forge: Callable[[bytes], bytes]
) -> None:
    run = PartsRun(Forger(tmp_path, **{f"command_used_{ROBOT}_{part}": forge}), network)
    run.steps(60)
    found = run.audited()
    assert found.parts[part].different > 0
    assert not found.is_equal
    assert all(one.different == 0 for name, one in found.parts.items() if name != part)
    told = {each.key: each.different for each in audit_in_short(open_episode(run.folder)).differences}
    assert told[keys.command_used(ROBOT)] > 0


def test_a_policy_that_got_another_command_than_the_parts_were_let_through_is_found(
    tmp_path: Path, network: Path
) -> None:
    run = PartsRun(Forger(tmp_path, **{f"command_used_{ROBOT}": nudged_whole}), network)
    run.steps(60)
    found = run.audited()
    assert found.commands.different == 60
    assert all(not one.different for one in found.parts.values())


def nudged_whole(data: bytes) -> bytes:
    return nudged(data) if len(data) == 8 * 18 else data


def test_what_was_commanded_before_the_file_began_is_not_proven_and_not_called_different(
    tmp_path: Path, network: Path
) -> None:
    run = PartsRun(EpisodeBuilder(tmp_path), network, seed=4)
    run.steps(230, is_recorded=False)
    run.steps(300)
    found = run.audited()
    assert (found.commands.different, found.gates_different) == (0, 0)
    assert found.commands_not_proven
    assert {why.split(":")[0] for why in found.commands_not_proven} <= set(PARTS)
    assert all(one.compared > 150 for one in found.parts.values())


def test_a_robot_that_was_stopped_and_put_on_its_feet_is_followed_on(tmp_path: Path, network: Path) -> None:
    run = PartsRun(EpisodeBuilder(tmp_path), network, seed=2)
    run.steps(80)
    run.control.stop("by hand")
    run.steps(20)
    run.is_released = True
    run.steps(200)
    found = run.audited()
    assert (found.commands.different, found.gates_different) == (0, 0)
    assert set(found.commands_not_proven) <= {f"{part}: where it rested is not in the file" for part in PARTS}, (
        found.commands_not_proven
    )
    assert sum(found.commands_not_proven.values()) <= 8


def test_an_episode_from_before_each_part_s_command_was_recorded_is_read_and_its_gates_are_not_proven(
    tmp_path: Path, network: Path
) -> None:
    class Old(EpisodeBuilder):
        def write(self, values: Mapping[str, bytes], **where: Any) -> None:
            super().write({k: v for k, v in values.items() if not k.startswith("command_timing_")}, **where)

    run = PartsRun(Old(tmp_path), network)
    run.steps(60)
    found = run.audited()
    assert (found.steps, found.different, found.observations.different) == (60, 0, 0)
    assert sum(found.commands_not_proven.values()) == 180
    assert found.is_equal
