"""From the recorded command to what the gate let through, and from the action to the targets: equal, different, or said
to be not proven, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servers.g1 import G1Config
from station import registry
from station.bus import codec, keys
from station.bus.stamp import boot_id
from station.cli.audit import story
from station.config import to_plain
from station.control.arming import Arming
from station.control.command_path import CommandPath
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig
from station.control.rig import PolicyChoice
from station.episode.reading.reader import open_episode
from station.episode.replaying.audit import Audit, audit
from station.protocols import Floats, RobotState
from tests.episode import lock_step
from tests.episode.linear_policy import LinearPolicy
from tests.episode.synthetic import MONO_START_NS, ROBOT, STANDING, EpisodeBuilder, command

PERIOD_NS = 20_000_000
FADE = 11
"""Steps until no velocity can be on its way back from a hold that was before the file, 0.2 s."""

IN_THE_MIDDLE = "begins in the middle of what the gate did"


class Forger(EpisodeBuilder):
    """Writes something else in the place of some values."""

    def __init__(self, data: Path, **forged: Callable[[bytes], bytes]) -> None:
        super().__init__(data)
        self._forged = forged

    def write(self, values: Mapping[str, bytes], **where: Any) -> None:
        families = {key: next((name for name in self._forged if key.startswith(name)), "") for key in values}
        super().write({key: self._forged[families[key]](value) if families[key] else value for key, value in
                       values.items()}, **where)  # fmt: skip


def noise(data: bytes) -> bytes:
    values = codec.parse_f64(data)
    return codec.f64(values + np.random.default_rng(7).normal(0.0, 0.1, values.shape))


def zeros(data: bytes) -> bytes:
    return codec.json_vector(np.zeros(len(codec.parse_json_vector(data))))


def nudged(data: bytes) -> bytes:
    """The last bit of the last number."""
    return data[:-8] + bytes([data[-8] ^ 1]) + data[-7:]


def test_of_a_lock_step_run_every_command_and_every_target_is_derived_again(tmp_path: Path) -> None:
    found = audit(open_episode(lock_step.record(EpisodeBuilder(tmp_path), seconds=2.0)))
    assert (found.commands.compared, found.commands.different, found.commands_not_proven) == (100, 0, {})
    assert (found.targets.compared, found.targets.different, found.targets_not_proven) == (100, 0, {})
    assert found.gates_different == 0
    assert found.is_equal
    assert "after gate    100 steps, 0 different" in story(found)
    assert "targets       100 steps, 0 different" in story(found)


@pytest.mark.parametrize(
    ("family", "forge", "what"),
    [("target_", noise, "targets"), ("target_", nudged, "targets"), ("action_body_", zeros, "commands")],
)
def test_targets_and_commands_that_were_forged_are_found(
    tmp_path: Path, family: str, forge: Callable[[bytes], bytes], what: str
) -> None:
    found = audit(open_episode(lock_step.record(Forger(tmp_path, **{family: forge}), seconds=2.0)))
    comparison = found.targets if what == "targets" else found.commands
    assert comparison.different >= 40
    assert (found.different, found.observations.different) == (0, 0), "which is all that an audit saw before"
    assert not found.is_equal


def test_a_recording_that_begins_while_a_command_is_tracked_is_taken_up_there(tmp_path: Path) -> None:
    found = audit(open_episode(lock_step.record(EpisodeBuilder(tmp_path), seconds=2.0, skip=70)))
    assert (found.commands.compared, found.commands.different) == (30 - FADE, 0)
    assert found.commands_not_proven == {IN_THE_MIDDLE: FADE}
    assert f"{FADE} steps not proven: {IN_THE_MIDDLE}" in story(found)


def test_a_blend_whose_beginning_is_not_in_the_file_is_not_proven(tmp_path: Path) -> None:
    found = audit(open_episode(lock_step.record(EpisodeBuilder(tmp_path), seconds=2.0, skip=20)))
    assert found.commands.different == 0
    assert found.commands_not_proven[IN_THE_MIDDLE] > 25
    assert found.commands.compared + found.commands_not_proven[IN_THE_MIDDLE] == 80


def test_targets_of_a_hand_over_are_not_called_equal(tmp_path: Path) -> None:
    stiff = {"stiff": PolicyChoice(policy="tracker", policy_options={"wrist_gains": "training"})}
    config = G1Config(pace="command", physics_dt_s=0.002, policies=stiff, blend_s=0.2)
    builder = EpisodeBuilder(tmp_path)
    found = audit(open_episode(lock_step.record(builder, seconds=3.0, config=config, switches={60: "stiff"})))
    assert found.targets.different == 0
    assert found.targets_not_proven == {"targets of two policies were blended": 20}, "at the start nobody knows either"
    assert (found.targets.compared, found.commands.compared) == (130, 150)


class WallRun:
    """A robot that follows commands by the wall clock, as its server does it; its policy is the linear one."""

    def __init__(self, builder: EpisodeBuilder, config: GateConfig | None = None) -> None:
        self.builder, self.config = builder, config or GateConfig()
        self.format = registry.find("command", "twist2")
        self.path = CommandPath(self.format, self.config, Arming(is_armed=True))
        self._policy, self._rng = LinearPolicy(), np.random.default_rng(3)
        self._sample: CommandSample | None = None
        self._tick, self._seqs = 0, dict[str, int]()
        self._told: list[str] = []

    def ask(self, writer: str = "motion", vector: Floats | None = None, *, is_recorded: bool = True,
            is_obeyed: bool = True) -> None:  # fmt: skip
        """Write a command some milliseconds before the next step."""
        seq = self._seqs[writer] = self._seqs.get(writer, 0) + 1
        q = STANDING + 0.1 * np.sin(0.07 * self._tick + np.arange(29))
        data = codec.json_vector(command(q) if vector is None else vector)
        written_ns = self._now_ns() - 4_000_000 + int(self._rng.integers(0, 900_000))
        arrived_ns = written_ns + 300_000
        source = f"{writer}.100.{boot_id()}.beef"
        if is_recorded:
            at_s = (written_ns - MONO_START_NS) * 1e-9
            self.builder.write({self.format.key: data}, at_s=at_s, writer=writer)
        else:
            self.builder.skip(self.format.key, writer=writer)
        if is_obeyed:
            delay_s = (arrived_ns - written_ns) * 1e-9
            self._sample = CommandSample(data, arrived_ns * 1e-9, delay_s, written_ns, arrived_ns, seq, source)

    def reset(self) -> None:
        """As an operator, or as a server does it whose robot fell."""
        self.path.reset("as asked")
        self._told.append("operator-reset")

    def step(self, *, is_recorded: bool = True) -> None:
        now_ns = self._now_ns() + int(self._rng.integers(0, 400_000))
        decision = self.path.decide(self._sample, now_ns * 1e-9)
        self.path.taken()
        state = RobotState(0, STANDING, np.zeros(29), np.array([1.0, 0, 0, 0]), np.zeros(3))
        observation = self._policy.observe(state, decision.vector)
        action = self._policy.act(observation)
        targets = self._policy.targets(action, decision.vector)
        q = STANDING if decision.state == "stopped" else targets.q
        good, at_s = self.path.validator.good, (now_ns - MONO_START_NS) * 1e-9
        numbers = (good.seq, good.written_ns, good.arrived_ns) if good else (0, 0, 0)
        measured = np.concatenate([state.q, state.dq, state.quat_wxyz, state.gyro])
        results = {
            keys.policy_obs(ROBOT): codec.f32(observation),
            keys.policy_action(ROBOT): codec.f32(action),
            keys.target(ROBOT): codec.f64(np.concatenate([q, targets.kp, targets.kd])),
            keys.command_gate(ROBOT): codec.json_object(self.path.status(decision)),
            keys.command_used(ROBOT): codec.f64(decision.vector),
            keys.policy_timing(ROBOT): codec.json_vector([self._tick + 1, *numbers, now_ns, now_ns, now_ns, now_ns]),
        }
        self._tick += 1
        if not is_recorded:
            for key in (keys.robot_state(ROBOT), *results):
                self.builder.skip(key)
            return
        self.builder.write({keys.robot_state(ROBOT): codec.f64(measured)}, at_s=at_s)
        self.builder.write(results, at_s=at_s + 0.001)
        for name in self._told:
            self.builder.event(name, at_s=at_s + 0.0015)
        self._told.clear()

    def follow(self, steps: int, writer: str = "motion") -> None:
        for _ in range(steps):
            self.ask(writer)
            self.step()

    def wait(self, steps: int) -> None:
        for _ in range(steps):
            self.step()

    def audited(self) -> Audit:
        facts = {
            "robot": ROBOT, "policy": {"name": "linear", "command": "twist2"}, "gate": to_plain(self.config),
            "rates": {"control_hz": 50.0, "pace": "wall"}, "robot_facts": {"physics_dt_s": 0.002},
        }  # fmt: skip
        folder = self.builder.finish({"servers": {"g1": facts}})
        return audit(open_episode(folder), policy=LinearPolicy())

    def _now_ns(self) -> int:
        return MONO_START_NS + 100_000_000 + self._tick * PERIOD_NS


@pytest.fixture
def run(tmp_path: Path) -> WallRun:
    return WallRun(EpisodeBuilder(tmp_path))


def assert_proven(found: Audit, steps: int) -> None:
    assert (found.commands.compared, found.commands.different, found.gates_different) == (steps, 0, 0)
    assert (found.targets.compared, found.targets.different) == (steps, 0)
    assert found.commands_not_proven == {}
    assert found.is_equal


def test_by_the_wall_clock_the_whole_gate_is_followed_bit_for_bit(run: WallRun) -> None:
    run.wait(5)
    run.follow(80)  # blends in, and tracks
    run.wait(200)  # holds, returns, waits
    run.follow(80)
    run.wait(10)  # holds
    run.follow(20)
    run.ask(vector=command(STANDING + 0.6))  # farther than one period lets it go
    run.wait(3)
    run.follow(30)
    assert_proven(run.audited(), 5 + 80 + 200 + 80 + 10 + 20 + 3 + 30)


def test_another_writer_is_entered_again_and_equal_numbers_of_both_are_told_apart(run: WallRun) -> None:
    run.follow(80)
    run.follow(90, "pico")  # its numbers begin at 1 too
    assert_proven(run.audited(), 170)


def test_a_command_of_a_refused_rival_with_the_same_number_is_not_taken_for_the_one_that_was_used(run: WallRun) -> None:
    for _ in range(90):
        run.ask()
        run.ask("pico", command(STANDING + 0.5), is_obeyed=False)
        run.step()
    assert_proven(run.audited(), 90)


def test_a_stop_and_a_reset_are_followed(run: WallRun) -> None:
    run.follow(70)
    run.path.stop("pressed")
    run.follow(20)
    run.reset()
    run.follow(10)  # not obeyed: it has to let go first
    run.wait(25)
    run.follow(70)
    assert_proven(run.audited(), 70 + 20 + 10 + 25 + 70)


def test_a_robot_that_was_put_on_its_feet_enters_anew(run: WallRun) -> None:
    run.follow(70)
    run.reset()
    run.follow(70)
    assert_proven(run.audited(), 140)


def test_a_command_that_is_not_in_the_file_is_said_and_what_follows_is_proven(run: WallRun) -> None:
    run.follow(70)
    run.ask(is_recorded=False)
    run.step()
    run.follow(20)
    found = run.audited()
    assert found.commands_not_proven == {"its command is not in the file": 1, IN_THE_MIDDLE: 1}
    assert (found.commands.compared, found.commands.different) == (70 + 19, 0)


def test_after_missing_steps_it_is_taken_up_again(run: WallRun) -> None:
    run.follow(70)
    for _ in range(3):
        run.ask()
        run.step(is_recorded=False)
    run.follow(20)
    found = run.audited()
    assert found.commands_not_proven == {IN_THE_MIDDLE: FADE}
    assert (found.commands.compared, found.commands.different) == (70 + 20 - FADE, 0)


@pytest.mark.parametrize("number", [3, 40, 100])
def test_one_bit_of_one_command_that_was_used_is_found(tmp_path: Path, number: int) -> None:
    seen = 0

    def forge(data: bytes) -> bytes:
        nonlocal seen
        seen += 1
        return nudged(data) if seen == number + 1 else data

    run = WallRun(Forger(tmp_path, command_used_=forge))
    run.follow(150)
    found = run.audited()
    assert (found.commands.different, found.commands.first_different) == (1, number)
    assert not found.is_equal


def test_a_state_of_the_gate_that_was_forged_is_found(tmp_path: Path) -> None:
    def forge(data: bytes) -> bytes:
        return data.replace(b'"entering"', b'"tracking"')

    run = WallRun(Forger(tmp_path, command_gate_=forge))
    run.follow(80)
    found = run.audited()
    assert found.gates_different > 0
    assert not found.is_equal


def test_where_the_manifest_does_not_say_how_the_gate_was_set_nothing_is_proven(run: WallRun) -> None:
    run.follow(20)
    found = audit(open_episode(run.builder.finish({})), policy=LinearPolicy())
    assert found.commands.compared == 0
    assert found.commands_not_proven == {"the manifest does not say how the gate was set": 20}
    assert "after gate    NOT AUDITED: 20 steps not proven: the manifest does not say" in story(found)


def test_what_a_robot_may_have_limited_itself_is_no_difference(tmp_path: Path) -> None:
    run = WallRun(Forger(tmp_path, target_=noise))
    run.follow(20)
    found = audit(open_episode(run.builder.finish({})), policy=LinearPolicy())
    assert (found.targets.compared, found.targets.different) == (0, 0)
    assert found.targets_not_proven == {"the target is not the policy's, and the robot may have limited it": 20}
