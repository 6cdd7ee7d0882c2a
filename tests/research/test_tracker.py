"""How the tracker is trained: what teacher and student see, what the commands are, and that a run gives a policy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.policies.tracker.policy import OBSERVATION, TrackerPolicy
from adapters.policies.twist2 import DEFAULT_Q, FRAME, gains, write_frame
from adapters.retarget.walking import FASTEST, FASTEST_BACK, LOWEST_M, VelocityCommand
from adapters.robots.g1 import joints
from adapters.robots.g1.joints import G1_29
from adapters.robots.legged.unitree import G1
from benchmarks.walking import session
from research.crowd import Crowd, States
from research.recipe import Crowd as CrowdRecipe
from research.tracker import envelope
from research.tracker.__main__ import main
from research.tracker.frames import frames, noise_scales
from research.tracker.gated import BLEND_IN, gated
from research.tracker.streams import ARMS, HEAD, wandering
from station import assets as files
from station.control.rig import RigConfig, build
from station.protocols import Floats, RobotState
from station.rehearse import rehearse
from station.rotations import normalized

MODEL = files.resolve("builtin:g1.xml")


def _states(count: int) -> States:
    random = np.random.default_rng(3)
    return States(
        q=DEFAULT_Q + random.normal(size=(count, 29)) * 0.2,
        dq=random.normal(size=(count, 29)),
        quat_wxyz=normalized(np.array([1.0, 0, 0, 0]) + random.normal(size=(count, 4)) * 0.1),
        gyro=random.normal(size=(count, 3)),
        root_pos=np.tile([0.0, 0.0, 0.78], (count, 1)),
        lin_vel=np.zeros((count, 3)),
        bias=np.zeros((count, 29)),
    )


def test_a_frame_made_for_many_robots_is_that_of_the_policy_for_each() -> None:
    states, random = _states(5), np.random.default_rng(4)
    commands = random.normal(size=(5, 35))
    actions = random.normal(size=(5, 29)).astype(np.float32)
    made = frames(states, commands, actions)
    for row in range(5):
        state = RobotState(0, states.q[row], states.dq[row], states.quat_wxyz[row], states.gyro[row])
        expected = np.empty(FRAME, dtype=np.float32)
        write_frame(expected, state, commands[row], actions[row])
        np.testing.assert_array_equal(made[row], expected)


def test_noise_falls_on_what_is_measured_alone() -> None:
    scales = noise_scales((0.01, 0.5, 0.1, 0.02))
    assert not scales[:35].any(), "the command"
    assert not scales[98:].any(), "the previous action"
    np.testing.assert_allclose(scales[[35, 38, 40, 69]], [0.1 * 0.25, 0.02, 0.01, 0.5 * 0.05], rtol=1e-6)


def _ramp() -> Floats:
    stream = np.tile(FORMAT.default, (600, 1))
    stream[:, 0] = np.linspace(0.0, 1.0, 600)
    return stream


def test_a_gated_episode_begins_standing_has_its_length_and_blends_no_faster_than_the_gate() -> None:
    for seed in range(20):
        rows = gated(_ramp, np.random.default_rng(seed), 800)
        assert rows.shape == (800, 35)
        np.testing.assert_array_equal(rows[0], FORMAT.default)
        falling = -np.diff(rows[:, 0])
        begins_at_once = falling > 1.01 / BLEND_IN  # a stream that begins without a blend, below where the last was
        assert begins_at_once.sum() <= 6


def test_wandering_arms_stay_in_their_ranges_and_below_four_fifths_of_their_speed() -> None:
    random = np.random.default_rng(5)
    arms = wandering(random, 2000, ARMS, start=FORMAT.default[ARMS])
    assert (arms >= FORMAT.lower[ARMS] - 1e-9).all()
    assert (arms <= FORMAT.upper[ARMS] + 1e-9).all()
    speed = np.abs(np.diff(arms, axis=0)) / 0.02
    assert (speed <= 0.85 * joints.velocity(G1_29)[ARMS - HEAD]).all()
    assert arms.std(axis=0).min() > 0.2


def test_robots_differ_where_the_recipe_says_so_and_stand_where_they_are_put() -> None:
    kp, kd = gains(4.0, 0.2)
    config = CrowdRecipe(robots=5, bodies=3)
    crowd = Crowd(G1, [MODEL], kp, kd, config, np.random.default_rng(1), threads=2)
    try:
        targets = np.tile(DEFAULT_Q, (5, 1))
        for _ in range(5):
            crowd.step(targets, targets, np.zeros(5))
        q = crowd.read().q
        np.testing.assert_array_equal(q[0], q[3])  # the same body
        assert not np.array_equal(q[0], q[2])  # a varied one
        crowd.push(0, np.array([0.3, 0.0]))
        crowd.restart(3)
        assert crowd.read().root_pos[3, 2] == 0.793
    finally:
        crowd.close()


def test_targets_that_come_late_come_late() -> None:
    kp, kd = gains(4.0, 0.2)
    crowd = Crowd(G1, [MODEL], kp, kd, CrowdRecipe(robots=3, bodies=1), np.random.default_rng(1), threads=1)
    try:
        before, targets = np.tile(DEFAULT_Q, (3, 1)), np.tile(DEFAULT_Q, (3, 1))
        targets[:, ARMS - HEAD] += 0.3
        crowd.step(before, targets, np.array([0.0, 0.5, 1.0]))
        moved = crowd.read().q[:, ARMS - HEAD].sum(axis=1)
        assert moved[0] > moved[1] > moved[2]
    finally:
        crowd.close()


@pytest.mark.torch
@pytest.mark.assets
def test_the_tutor_moves_arms_by_the_motors_equation_and_hides_wild_ones_from_the_teacher(assets: Path) -> None:
    from research.teacher import Network
    from research.tracker.tutor import Tutor

    kp, kd = gains(4.0, 0.2)
    network = Network(assets / "twist2/ckpts/twist2_1017_20k.onnx", threads=1)
    states, commands = _states(2), np.tile(FORMAT.default, (2, 1))
    commands[1, ARMS] = FORMAT.upper[ARMS]
    states = States(**{name: np.repeat(getattr(states, name)[:1], 2, axis=0) for name in States.__slots__})
    newest = frames(states, commands, np.zeros((2, 29), np.float32))
    blind, seeing = Tutor(network, 2, 0.0, kp, kd), Tutor(network, 2, 1.0, kp, kd)
    labels = blind(newest, states, commands)
    legs = np.arange(12)
    np.testing.assert_allclose(labels[0, legs], labels[1, legs], atol=1e-5)
    other = seeing(newest, states, commands)
    assert np.abs(other[0, legs] - other[1, legs]).max() > 0.05
    # At rest and without weight, the target of an arm is its command.
    np.testing.assert_allclose(labels[:, ARMS - HEAD] * 0.5 + DEFAULT_Q[ARMS - HEAD], commands[:, ARMS], atol=1e-5)


@pytest.mark.torch
def test_the_onnx_file_computes_what_the_student_does(tmp_path: Path) -> None:
    import torch

    from research.network import Student, save_onnx

    torch.manual_seed(0)
    student = Student(OBSERVATION, (64, 32), 29)
    random = np.random.default_rng(0)
    student.measure(random.normal(size=(100, OBSERVATION)).astype(np.float32))
    save_onnx(student, tmp_path / "small.onnx", {"seed": "0"})
    observation = random.normal(size=OBSERVATION).astype(np.float32)
    with torch.inference_mode():
        expected = student(torch.from_numpy(observation)[None]).numpy()[0]
    np.testing.assert_allclose(TrackerPolicy(tmp_path / "small.onnx").act(observation), expected, atol=1e-5)


TINY = """
rounds: 2
made: 2
steps_per_round: 20
batches_per_round: 5
polish_batches: 5
batch: 64
hidden: [32, 16]
meshed_model: ""
motions: ["twist2:motions/0807_yanjie_walk_002.pkl"]
mirrored: []
crowd: {robots: 4, bodies: 2}
"""


@pytest.mark.torch
@pytest.mark.assets
@pytest.mark.usefixtures("assets")
def test_a_run_writes_a_policy_and_its_log_and_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(TINY)
    outs = [tmp_path / "first", tmp_path / "second"]
    for out in outs:
        assert main(["--out", str(out), "--recipe", str(tmp_path / "tiny.yaml"), "--threads", "1"]) == 0
    policy = TrackerPolicy(outs[0] / "tracker.onnx")
    assert np.isfinite(policy.act(np.zeros(OBSERVATION, np.float32))).all()
    log = json.loads((outs[0] / "training.json").read_text())
    assert [entry["round"] for entry in log["rounds"]] == [1, 2, 2]
    assert log["recipe"]["crowd"]["robots"] == 4
    assert outs[0].joinpath("tracker.onnx").read_bytes() == outs[1].joinpath("tracker.onnx").read_bytes()


def test_a_recipe_with_an_unknown_field_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.yaml").write_text("rouns: 3\n")
    assert main(["--out", str(tmp_path), "--recipe", str(tmp_path / "bad.yaml")]) == 2
    assert "rouns" in capsys.readouterr().err


@pytest.mark.parametrize(
    "wish", [VelocityCommand(*FASTEST), VelocityCommand(-FASTEST_BACK), VelocityCommand(height=LOWEST_M)]
)
def test_what_sticks_ask_for_is_within_the_envelope_to_the_last_bit(wish: VelocityCommand) -> None:
    rig = build(RigConfig(robot="g1-mujoco", policy="tracker"))
    beyond: list[tuple[int, ...]] = []
    done = rehearse(
        envelope.Walk("sticks", [(4.0, wish)]), rig.policy, rig.robot, rig.command_format, envelopes=rig.envelopes,
        on_step=lambda _, record: beyond.append(record.decision.beyond),
    )  # fmt: skip
    assert not done.fell
    assert len(beyond) > 300
    assert not any(beyond)
    rig.robot.close()


def test_who_walks_by_sticks_with_hands_at_work_is_hardly_held_back_by_the_envelope() -> None:
    """Measured of motions alone, it changed his command in nine of ten ticks."""
    beyond: list[bool] = []
    rig = build(RigConfig(robot="g1-mujoco", policy="tracker"))
    done = session(rig, 0, 40.0, lambda record: beyond.append(bool(record.decision.beyond)))
    assert not done.fell
    assert np.mean(beyond) < 0.1
    rig.robot.close()
