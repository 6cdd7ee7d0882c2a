"""The offline closed loop: real policies, real physics."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from station import registry
from station.bus import codec
from station.control.control import StepRecord
from station.control.rig import RigConfig, build
from station.errors import StationError, UsageError
from station.motion.playback import Frame
from station.rehearse import Rehearsal, rehearse, rehearse_all

BUILT_IN = ["builtin:walk-forward", "builtin:wave"]
ALL_OF_TWIST2 = [f"twist2:motions/0807_yanjie_walk_00{number}.pkl" for number in range(1, 7)]
UPSTREAM = [ALL_OF_TWIST2[1], ALL_OF_TWIST2[3]]  # the shortest; `test_proof_rehearse` has all
AS_UPSTREAM = RigConfig(policy="twist2", robot_options={"model": "twist2:g1/g1_sim2sim_29dof.xml"})


class Ramp:
    """A motion that bends the knees of a standing robot, a second long."""

    name = "ramp"
    fps = 50.0
    duration_s = 1.0

    def __init__(self, joint_names: tuple[str, ...], lean_rad: float = 0.0) -> None:
        self.joint_names = joint_names
        self._base = registry.find("loader", "motion")("builtin:stand").at(0.0)
        self._lean = lean_rad

    def at(self, time_s: float) -> object:
        from dataclasses import replace

        from station.rotations import from_rotation_vector

        quat = from_rotation_vector(np.array([0.0, self._lean * min(time_s, 1.0), 0.0]))
        return replace(self._base, root_quat_wxyz=quat)

    def facts(self) -> dict[str, object]:
        return {}


@pytest.mark.parametrize(
    ("motions", "config", "physics_dt_s"),
    [
        pytest.param(BUILT_IN, RigConfig(), 0.001, id="built in, as upstream simulates"),
        pytest.param(BUILT_IN, RigConfig(), 0.002, id="built in, as the station simulates"),
        pytest.param(UPSTREAM, AS_UPSTREAM, 0.002, marks=pytest.mark.assets, id="upstream"),
    ],
)
def test_motions_run_to_their_end_without_a_fall(
    processes: None, motions: list[str], config: RigConfig, physics_dt_s: float
) -> None:
    assert_all_end_well(motions, config, physics_dt_s)


def assert_all_end_well(motions: list[str], config: RigConfig, physics_dt_s: float) -> None:
    came: list[str] = []
    config = msgspec.structs.replace(config, robot_options=config.robot_options | {"physics_dt_s": physics_dt_s})
    results = rehearse_all(motions, config, jobs=2, on_done=lambda result: came.append(result.motion))
    assert [result.motion for result in results] == motions
    assert sorted(came) == motions
    for result in results:
        assert not result.fell, result
        assert result.fell_at_s is None
        assert result.mean_joint_error_rad is not None
        assert 0.02 < result.mean_joint_error_rad <= 0.10, result
        assert result.mean_root_height_error_m is not None
        assert result.mean_root_height_error_m < 0.05, result
        assert result.seconds > 5.0


def test_a_rehearsal_is_the_same_every_time_also_in_a_rig_that_was_used() -> None:
    rig = build(RigConfig(robot_options={"physics_dt_s": 0.002}))
    motion = Ramp(rig.robot.joint_names)

    def run() -> Rehearsal:
        return rehearse(motion, rig.policy, rig.robot, rig.command_format, period_s=rig.period_s)  # type: ignore[arg-type]

    first, second = run(), run()
    assert first.mean_joint_error_rad == second.mean_joint_error_rad
    assert first.mean_root_height_error_m == second.mean_root_height_error_m
    assert first.seconds == second.seconds


def test_only_ticks_that_play_and_track_count_and_commands_pass_through_their_text() -> None:
    rig = build(RigConfig(robot_options={"physics_dt_s": 0.002}))
    seen: list[tuple[Frame, StepRecord]] = []
    result = rehearse(
        Ramp(rig.robot.joint_names), rig.policy, rig.robot, rig.command_format,  # type: ignore[arg-type]
        on_step=lambda frame, record: seen.append((frame, record)),
    )  # fmt: skip
    counted = [
        np.abs(record.state.q - record.decision.vector[6:]).mean()
        for frame, record in seen
        if frame.phase == "playing" and record.decision.state == "tracking"
    ]
    assert result.mean_joint_error_rad == pytest.approx(np.mean(counted), rel=1e-12)
    assert 0 < len(counted) < len(seen)
    assert result.seconds == pytest.approx(len(seen) * 0.02)
    for frame, record in seen:
        if record.decision.state == "tracking":
            sent = codec.parse_json_vector(codec.json_vector(frame.command))
            np.testing.assert_array_equal(
                record.decision.vector, np.clip(sent, rig.command_format.lower, rig.command_format.upper)
            )


def test_a_fall_ends_the_run_and_its_motion_time_is_said() -> None:
    rig = build(RigConfig(robot_options={"physics_dt_s": 0.002}))
    motion = Ramp(rig.robot.joint_names, lean_rad=-1.4)  # leans back as no robot can
    result = rehearse(motion, rig.policy, rig.robot, rig.command_format)  # type: ignore[arg-type]
    assert result.fell
    assert result.fell_at_s is not None
    assert 0.0 <= result.fell_at_s <= 1.0


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_motion_that_cannot_be_read_ends_the_rehearsal_in_one_line(
    processes: None, tmp_path: Path, jobs: int
) -> None:
    bad = tmp_path / "bad.pkl"
    bad.write_bytes(b"\x80\x04cos\nsystem\n.")
    with pytest.raises(UsageError, match=r"bad\.pkl") as caught:
        rehearse_all([str(bad), str(bad)], RigConfig(robot_options={"physics_dt_s": 0.002}), jobs=jobs)
    assert "\n" not in str(caught.value)


def test_a_policy_without_a_default_checkpoint_asks_for_one() -> None:
    with pytest.raises(StationError, match="name its file with `checkpoint`"):
        build(RigConfig(policy="twist"))


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (RigConfig(policy="twistt2"), r"unknown policy 'twistt2' \(did you mean 'twist2'\?\)"),
        (RigConfig(robot="g1-mojoco"), r"did you mean 'g1-mujoco'\?"),
        (RigConfig(policy_options={"wrist_gain": "real"}), r"did you mean 'wrist_gains'\?"),
        (RigConfig(rate_hz=0.5), "expected 1 to 1000 Hz"),
        (RigConfig(robot_options={"physics_dt_s": 0.003}), "whole number of times"),
        (RigConfig(checkpoint="twist2:ckpts/twist2_1017_25k.onnx"), "did you mean 'ckpts/twist2_1017_20k.onnx'"),
    ],
)
def test_what_cannot_be_put_together_says_what_could(config: RigConfig, expected: str) -> None:
    with pytest.raises(StationError, match=expected):
        build(config)
