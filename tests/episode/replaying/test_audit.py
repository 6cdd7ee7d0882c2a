"""Auditing: equal bits are equal, one flipped bit is found, and what cannot be compared is said in one line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servers.g1 import G1Config
from station import assets
from station.bus import codec, keys
from station.cli.audit import in_short, story
from station.control.rig import PolicyChoice
from station.episode.reading.reader import open_episode
from station.episode.replaying.audit import Audit, audit
from station.episode.replaying.comparison import Comparison
from station.episode.storage.manifest import load_manifest, save_manifest
from station.errors import AssetMissing, BadFile, EpisodeError, UnknownName
from station.protocols import PolicySpec, RobotState
from tests.episode import lock_step
from tests.episode.linear_policy import LinearPolicy
from tests.episode.synthetic import ROBOT, STANDING, EpisodeBuilder, command


class LinearRun:
    """Writes steps of the linear policy; a step can be lost, spoilt, or follow a reset."""

    def __init__(self, builder: EpisodeBuilder, *, without: str = "") -> None:
        self._builder, self._policy, self._number, self._without = builder, LinearPolicy(), 0, without

    def step(self, *, flip: str = "", lose_state: bool = False, lose_result: bool = False, reset: bool = False) -> None:
        number, self._number = self._number, self._number + 1
        at_s = 0.1 + number / 50
        if reset:
            self._policy.reset()
        q, asked = STANDING + 0.01 * np.sin(number), command(height=0.7 + 0.01 * np.cos(number))
        state = RobotState(0, q, np.zeros(29), np.array([1.0, 0, 0, 0]), np.zeros(3))
        observation = self._policy.observe(state, asked)
        action = self._policy.act(observation)
        measured = np.concatenate([q, np.zeros(29), [1.0, 0, 0, 0], np.zeros(3)])
        results = {
            keys.policy_obs(ROBOT): _flipped(codec.f32(observation), flip == "observation"),
            keys.policy_action(ROBOT): _flipped(codec.f32(action), flip == "action"),
            keys.command_used(ROBOT): codec.f64(asked),
        }
        results.pop(self._without, None)
        self._write({keys.robot_state(ROBOT): codec.f64(measured)}, at_s, is_lost=lose_state)
        self._write(results, at_s + 0.003, is_lost=lose_result)

    def _write(self, values: dict[str, bytes], at_s: float, *, is_lost: bool) -> None:
        if not is_lost:
            self._builder.write(values, at_s=at_s)
            return
        for key in values:
            self._builder.skip(key)


def _flipped(data: bytes, flip: bool) -> bytes:
    return bytes([data[0] ^ 1]) + data[1:] if flip else data


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path)


def audited(builder: EpisodeBuilder) -> Audit:
    return audit(open_episode(builder.finish()), policy=LinearPolicy())


UNSEEN = keys.policy_obs(ROBOT)


def test_observations_that_are_not_recorded_are_derived_and_equal_by_their_actions(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder, without=UNSEEN)
    for number in range(50):
        run.step(reset=number == 20)
    found = audited(builder)
    assert (found.steps, found.different, found.past_unknown, found.incomplete) == (50, 0, 0, 0)
    assert (found.has_observations, found.observations.compared) == (False, 0)
    assert found.is_equal
    assert "observations  not recorded; derived, and equal where the actions are\n" in story(found)


def test_an_action_of_an_observation_that_is_not_recorded_is_told_where_it_differs(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder, without=UNSEEN)
    for number in range(50):
        run.step(flip="action" if number == 30 else "", reset=number == 40)
    found = audited(builder)
    assert (found.steps, found.different, found.first_different) == (41, 1, 30)
    assert found.past_unknown == 9, "nothing is proven from there to the reset"
    assert not found.is_equal


def test_without_observations_nothing_is_proven_before_a_policy_began_anew(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder, without=UNSEEN)
    for number in range(30):
        run.step(lose_result=number < 5, lose_state=number == 12, reset=number == 20)
    found = audited(builder)
    assert (found.steps, found.different, found.past_unknown) == (10, 0, 15)
    assert "15 steps not proven: what the policy had seen before is not in the file" in story(found)
    never = EpisodeBuilder(builder.folder.parent.parent, number=2)
    run = LinearRun(never, without=UNSEEN)
    for number in range(30):
        run.step(lose_result=number < 5)
    assert not audited(never).is_equal, "of which not one step was compared"


def test_an_honest_episode_is_equal_bit_for_bit(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder)
    for _ in range(50):
        run.step()
    found = audited(builder)
    assert (found.steps, found.different, found.max_abs_difference) == (50, 0, 0.0)
    assert (found.observations.compared, found.observations.different) == (50, 0)
    assert found.is_equal
    assert found.segments == 1
    assert in_short(found).endswith("run again on what was recorded: 50 steps, 0 different")


@pytest.mark.parametrize("which", ["action", "observation"])
def test_a_single_flipped_bit_is_found(builder: EpisodeBuilder, which: str) -> None:
    run = LinearRun(builder)
    for number in range(50):
        run.step(flip=which if number == 30 else "")
    found = audited(builder)
    spoilt: Any = found if which == "action" else found.observations
    assert (spoilt.different, spoilt.first_different) == (1, 30)
    assert 0.0 < spoilt.max_abs_difference < 1e-5
    assert not found.is_equal


def test_a_flipped_observation_shows_in_its_action_and_not_in_later_steps(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder)
    for number in range(50):
        run.step(flip="observation" if number == 30 else "")
    found = audited(builder)
    assert found.different <= 1
    assert found.observations.different == 1
    assert in_short(found) == story(found), "one line would say that its actions are the same"


@pytest.mark.parametrize("fault", ["lose_state", "lose_result"])
def test_a_missing_tick_starts_a_new_segment_and_is_no_difference(builder: EpisodeBuilder, fault: str) -> None:
    run = LinearRun(builder)
    for number in range(50):
        run.step(**{fault: number == 20})
    found = audited(builder)
    assert found.segments > 1
    assert found.is_equal


def test_observations_of_which_none_can_be_derived_are_not_audited(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder)
    for _ in range(20):
        run.step(lose_state=True)
    found = audited(builder)
    assert (found.steps, found.different, found.observations.compared) == (20, 0, 0)
    assert not found.is_equal
    assert f"observations  NOT AUDITED: step 0 has no {keys.robot_state(ROBOT)} that fits" in story(found)


def test_a_reset_of_the_policy_is_no_difference(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder)
    for number in range(50):
        run.step(reset=number == 25)
    assert audited(builder).is_equal


def test_an_episode_that_begins_in_mid_run_is_taken_up_where_it_begins(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder)
    for number in range(50):
        run.step(lose_state=number < 10, lose_result=number < 10)
    found = audited(builder)
    assert (found.steps, found.is_equal) == (40, True)
    assert found.observations.compared == 39  # of the first, the past is not known


def test_another_policy_is_told_by_the_largest_difference(builder: EpisodeBuilder) -> None:
    run = LinearRun(builder)
    for _ in range(10):
        run.step()
    found = audit(open_episode(builder.finish()), policy=LinearPolicy(gain=1.001))
    assert found.different == 10
    assert 1e-4 < found.max_abs_difference < 1e-1


def test_what_is_no_number_differs_by_infinity_from_a_number() -> None:
    comparison = Comparison()
    comparison.add(0, np.array([1.0], dtype=np.float32), np.array([np.nan], dtype=np.float32))
    assert comparison.max_abs_difference == np.inf


def test_episode_without_steps_is_refused_in_one_line(builder: EpisodeBuilder) -> None:
    builder.event("mark", at_s=0.1)
    with pytest.raises(EpisodeError, match="no policy steps") as caught:
        audit(open_episode(builder.finish()))
    assert "\n" not in str(caught.value)


def test_an_episode_of_which_nothing_can_be_compared_is_not_equal(builder: EpisodeBuilder) -> None:
    builder.write({keys.policy_obs(ROBOT): bytes(4), keys.policy_action(ROBOT): bytes(4)}, at_s=0.1)
    found = audited(builder)
    assert (found.steps, found.different, found.incomplete) == (0, 0, 1)
    assert not found.is_equal


class Remembering(LinearPolicy):
    """The same with more behind its observation, as the state of an LSTM."""

    @property
    def spec(self) -> PolicySpec:
        return replace(super().spec, name="remembering", observation_size=132)


def test_what_was_recorded_without_what_the_policy_remembers_is_not_audited_and_a_line_says_why(
    builder: EpisodeBuilder,
) -> None:
    run = LinearRun(builder)
    for _ in range(5):
        run.step()
    found = audit(open_episode(builder.finish()), policy=Remembering())
    assert (found.steps, found.incomplete, found.is_equal) == (0, 5, False)
    told = next(line for line in story(found).splitlines() if "observations" in line)
    assert "NOT AUDITED: observations have 4 numbers, policy 'remembering' makes 132: " in told
    assert told.endswith("recorded without what it remembers (the state of an LSTM)")


def test_episode_that_does_not_name_its_policy_is_refused(builder: EpisodeBuilder) -> None:
    LinearRun(builder).step()
    with pytest.raises(EpisodeError, match="does not name the policy"):
        audit(open_episode(builder.finish()))


def _stated(**policy: str) -> dict[str, Any]:
    facts = {"name": "twist2", "checkpoint": "/nowhere/policy.onnx", "sha256": "0" * 64, **policy}
    return {"servers": {"g1": {"robot": ROBOT, "policy": facts}}}


@pytest.mark.parametrize(
    ("stated", "error", "words"),
    [
        ({}, BadFile, "/nowhere/policy.onnx: no such file"),
        ({"checkpoint": "twist2:ckpts/none.onnx"}, AssetMissing, "twist2:ckpts/none.onnx"),
        ({"name": "twist9", "checkpoint": __file__, "sha256": ""}, UnknownName, "twist9"),
        ({"checkpoint": __file__}, EpisodeError, "ran checkpoint sha256 000000000000…"),
    ],
)
def test_checkpoint_that_cannot_be_used_is_named_in_one_line(
    builder: EpisodeBuilder, stated: dict[str, str], error: type[Exception], words: str
) -> None:
    LinearRun(builder).step()
    with pytest.raises(error, match=words) as caught:
        audit(open_episode(builder.finish(_stated(**stated))))
    assert "\n" not in str(caught.value)


def test_on_another_machine_the_checkpoint_is_found_by_the_name_that_its_user_gave(builder: EpisodeBuilder) -> None:
    folder = lock_step.record(builder, seconds=0.5)
    manifest = load_manifest(folder)
    for facts in manifest.servers.values():
        facts["policy"]["checkpoint"] = "/the/recording/machine/policy.onnx"
        facts["config"] = {"checkpoint": "builtin:tracker.onnx"}
    save_manifest(manifest, folder)
    assert audit(open_episode(folder)).is_equal


def test_real_policy_gives_equal_bits_and_names_both_runtimes(builder: EpisodeBuilder) -> None:
    found = audit(open_episode(lock_step.record(builder, seconds=2.0)))
    assert (found.steps, found.different, found.observations.compared) == (100, 0, 100)
    assert found.is_equal
    assert found.sha256 == found.recorded_sha256
    assert found.runtime == found.recorded_runtime
    assert "onnxruntime" in found.runtime


def test_real_policy_is_taken_up_in_mid_run(builder: EpisodeBuilder) -> None:
    found = audit(open_episode(lock_step.record(builder, seconds=2.0, skip=50)))
    assert (found.steps, found.observations.compared) == (50, 49)
    assert found.is_equal


STIFF = {"stiff": PolicyChoice(policy="tracker", policy_options={"wrist_gains": "training"})}
"""The same network under another name, with other gains."""


def handed_over(builder: EpisodeBuilder, *, skip: int = 0) -> Path:
    """An episode of 3 s in which policies hand over to each other twice: asked for at steps 60 and 100."""
    config = G1Config(pace="command", physics_dt_s=0.002, policies=STIFF, blend_s=0.2)
    return lock_step.record(builder, seconds=3.0, skip=skip, config=config, switches={60: "stiff", 100: "tracker"})


def test_across_a_hand_over_each_step_is_derived_by_the_policy_that_drove(builder: EpisodeBuilder) -> None:
    found = audit(open_episode(handed_over(builder)))
    assert (found.steps, found.different) == (150, 0)
    assert (found.observations.compared, found.observations.different, found.segments) == (150, 0, 1)
    assert found.is_equal
    assert (found.policy, [each.policy for each in found.took_over]) == ("tracker", ["tracker"])
    assert "took over     tracker" in story(found)


@pytest.mark.parametrize(("skip", "compared"), [(65, 83), (70, 79), (90, 59)])
def test_a_recording_that_begins_during_a_hand_over_derives_what_it_can(
    builder: EpisodeBuilder, skip: int, compared: int
) -> None:
    found = audit(open_episode(handed_over(builder, skip=skip)))
    assert (found.steps, found.different) == (150 - skip, 0)
    assert (found.observations.compared, found.observations.different) == (compared, 0)


class Unseen(EpisodeBuilder):
    """Writes no observation down."""

    def write(self, values: Mapping[str, bytes], **where: Any) -> None:
        super().write({key: value for key, value in values.items() if key != UNSEEN}, **where)


@pytest.mark.parametrize(("skip", "compared"), [(0, 150), (65, 40), (90, 40)])
def test_without_observations_a_hand_over_is_derived_where_the_file_holds_what_both_had_seen(
    tmp_path: Path, skip: int, compared: int
) -> None:
    found = audit(open_episode(handed_over(Unseen(tmp_path), skip=skip)))
    assert (found.different, found.has_observations, found.incomplete) == (0, False, 0)
    assert (found.steps, found.past_unknown) == (compared, 150 - skip - compared)
    assert found.is_equal, "a policy that takes over later was heard from its beginning"


class Liar(EpisodeBuilder):
    """Writes down that the policy of the start drove all the time."""

    def write(self, values: Mapping[str, bytes], **where: Any) -> None:
        gate, lied = keys.command_gate(ROBOT), dict(values)
        if gate in values:
            lied[gate] = codec.json_object(codec.parse_facts(values[gate]) | {"policy": "tracker", "next_policy": ""})
        super().write(lied, **where)


def test_an_action_of_the_other_policy_is_noticed(tmp_path: Path) -> None:
    found = audit(open_episode(handed_over(Liar(tmp_path))))
    assert not found.is_equal
    assert found.observations.first_different == 70


def test_a_policy_that_never_drove_need_not_be_here_and_one_that_is_elsewhere_is_named(
    builder: EpisodeBuilder, tmp_path: Path
) -> None:
    folder = handed_over(builder)
    elsewhere = tmp_path / "moved.onnx"
    elsewhere.write_bytes(assets.resolve("builtin:tracker.onnx").read_bytes())
    manifest = load_manifest(folder)
    policies = manifest.servers["g1"]["policies"]
    policies["idle"] = policies["stiff"] | {"checkpoint": "nowhere.onnx", "sha256": "0" * 64}
    for name in ("tracker", "stiff"):
        policies[name]["checkpoint"] = "gone.onnx"
    save_manifest(manifest, folder)
    assert audit(open_episode(folder), checkpoint=elsewhere).is_equal
    elsewhere.write_bytes(b"another network")
    with pytest.raises(EpisodeError, match=r"ran checkpoints of sha256 stiff .*, tracker .*, idle 000.* none of them"):
        audit(open_episode(folder), checkpoint=elsewhere)
