"""How policies of velocities are trained: what student and teachers see, what is asked, and that a run gives one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.commands import twist2
from adapters.policies.falcon import FalconPolicy
from adapters.policies.playground import PlaygroundGo1Policy
from adapters.policies.walk.policy import G1WalkPolicy, Go2WalkPolicy, WalkPolicy
from adapters.robots.legged.unitree import G1, GO2
from research.crowd import Crowd, States
from research.recipe import Crowd as CrowdRecipe
from research.teacher import Network
from research.tracker.streams import ARMS
from research.walk.__main__ import main
from research.walk.recipe import Recipe
from research.walk.task import WalkTask, moved, velocities
from research.walk.teachers import FalconTeacher, Go1Teacher
from station import assets as files
from station.protocols import Floats, RobotState
from station.rotations import normalized, rotate_inverse

POLICIES: dict[str, tuple[type[WalkPolicy], float]] = {"go2": (Go2WalkPolicy, 0.3), "g1": (G1WalkPolicy, 0.793)}


def states_of(policy: type[WalkPolicy], count: int, seed: int = 3) -> States:
    random, joints = np.random.default_rng(seed), len(policy.JOINTS)
    return States(
        q=policy.DEFAULT_Q + random.normal(size=(count, joints)) * 0.2,
        dq=random.normal(size=(count, joints)),
        quat_wxyz=normalized(np.array([1.0, 0, 0, 0]) + random.normal(size=(count, 4)) * 0.1),
        gyro=random.normal(size=(count, 3)),
        root_pos=np.tile([0.0, 0.0, 0.3], (count, 1)),
        lin_vel=random.normal(size=(count, 3)),
        bias=np.zeros((count, joints)),
    )


def state_of(states: States, row: int) -> RobotState:
    return RobotState(
        0, states.q[row], states.dq[row], states.quat_wxyz[row], states.gyro[row],
        root_lin_vel=rotate_inverse(states.quat_wxyz[row], states.lin_vel[row]),
    )  # fmt: skip


def commands_of(policy: type[WalkPolicy], count: int) -> Floats:
    lower, upper = np.array(policy.RANGE).T
    velocity = np.random.default_rng(4).uniform(lower, upper, (count, 3))
    arms = np.tile(policy.DEFAULT_Q[policy.ACTIONS :], (count, 1))
    return np.concatenate([velocity, arms], axis=1)


@pytest.mark.parametrize("name", POLICIES)
def test_a_frame_made_for_many_robots_is_that_of_the_policy_for_each(name: str, tmp_path: Path) -> None:
    policy, height_m = POLICIES[name]
    states, commands = states_of(policy, 4), commands_of(policy, 4)
    previous = np.random.default_rng(5).normal(size=(4, policy.ACTIONS)).astype(np.float32)
    made = WalkTask(policy, None, Recipe(), height_m).see(states, commands, previous)
    one = policy.__new__(policy)  # its frame needs no network
    for row in range(4):
        expected = one._frame(state_of(states, row), commands[row, :3], previous[row].astype(np.float64))
        np.testing.assert_array_equal(made[row], expected)


@pytest.mark.parametrize("name", POLICIES)
def test_noise_falls_on_what_is_measured_alone(name: str) -> None:
    policy, height_m = POLICIES[name]
    scales = WalkTask(policy, None, Recipe(), height_m).noise((0.01, 0.5, 0.1, 0.02))
    assert scales.shape == (policy.FRAME,)
    assert not scales[6:9].any(), "the command"
    assert not scales[-policy.ACTIONS :].any(), "the previous output"
    np.testing.assert_allclose(scales[[0, 3, 9, 9 + len(policy.JOINTS)]], [0.1, 0.02, 0.01, 0.025], rtol=1e-6)


@pytest.mark.assets
def test_the_teacher_of_a_go2_is_its_own_projects_policy_with_the_legs_in_their_places(assets: Path) -> None:
    path = assets / "zoo/policies/playground_go1_policy.onnx"
    states, commands = states_of(Go2WalkPolicy, 3), commands_of(Go2WalkPolicy, 3)
    previous = np.random.default_rng(5).normal(size=(3, 12)).astype(np.float32)
    labels = Go1Teacher(Network(path, 1))(states, commands, previous)
    theirs = [Go2WalkPolicy.JOINTS.index(name) for name in PlaygroundGo1Policy.JOINTS]
    for row in range(3):
        policy, state = PlaygroundGo1Policy(path), state_of(states, row)
        policy._action = previous[row, theirs]
        state = RobotState(
            0, state.q[theirs], state.dq[theirs], state.quat_wxyz, state.gyro, root_lin_vel=state.root_lin_vel
        )
        expected = policy.act(policy.observe(state, commands[row]))
        np.testing.assert_allclose(labels[row, theirs], expected, atol=2e-5)


@pytest.mark.assets
def test_the_teacher_of_a_g1_is_falcon_of_which_the_arms_are_left_out(assets: Path) -> None:
    path = assets / "zoo/policies/falcon_g1_29dof.onnx"
    teacher = FalconTeacher(Network(path, 1), 2)
    policies = [FalconPolicy(path) for _ in range(2)]
    commands, previous = commands_of(G1WalkPolicy, 2), np.zeros((2, 15), np.float32)
    commands[1, :3] = 0.0
    for step in range(7):
        states = states_of(G1WalkPolicy, 2, seed=step)
        labels = teacher(states, commands, previous)
        for row, policy in enumerate(policies):
            told = np.concatenate([commands[row, :3], [teacher.HEIGHT_M, 0, 0, 0], commands[row, 3:]])
            expected = policy.act(policy.observe(state_of(states, row), told))
            np.testing.assert_allclose(labels[row], expected[:15], atol=2e-4)
        previous = labels


def test_what_is_asked_stays_in_the_range_and_begins_at_rest() -> None:
    lower, upper = np.array(G1WalkPolicy.RANGE).T
    for seed in range(20):
        rows = velocities(np.random.default_rng(seed), 500, lower, upper, 0.2)
        assert rows.shape == (500, 3)
        assert (rows >= lower - 1e-12).all()
        assert (rows <= upper + 1e-12).all()
        arms = moved(np.random.default_rng(seed), 500, G1WalkPolicy.DEFAULT_Q[15:])
        assert (arms >= twist2.FORMAT.lower[ARMS] - 1e-9).all()
        assert (arms <= twist2.FORMAT.upper[ARMS] + 1e-9).all()
        np.testing.assert_allclose(arms[0], G1WalkPolicy.DEFAULT_Q[15:], atol=0.02)


def test_arms_swing_at_one_rate_as_often_as_each_joint_at_its_own() -> None:
    """A policy that had never felt arms swing together fell while it stood, by 0.2 rad at 1 Hz."""
    alike = apart = 0
    for seed in range(200):
        arms = moved(np.random.default_rng(seed), 1000, G1WalkPolicy.DEFAULT_Q[15:])[100:]
        power = np.abs(np.fft.rfft(arms - arms.mean(axis=0), axis=0))[1:] ** 2
        peak, swings = power.argmax(axis=0), power.max(axis=0) > 0.5 * power.sum(axis=0)  # who wanders has no rate
        if swings.mean() > 0.7:
            alike += np.ptp(peak[swings]) <= 1
            apart += np.ptp(peak[swings]) > 5
    assert min(alike, apart) > 30


def test_a_teacher_that_falls_short_is_asked_for_more_and_one_that_stands_for_nothing() -> None:
    asked: list[Floats] = []

    class Lazy:
        def __call__(self, _states: States, commands: Floats, _previous: Floats) -> Floats:
            asked.append(commands)
            return np.zeros((3, 12), np.float32)

        def forget(self, _robot: int) -> None: ...

    task = WalkTask(Go2WalkPolicy, Lazy(), Recipe(crowd=CrowdRecipe(robots=3)), 0.3)
    states = replace(states_of(Go2WalkPolicy, 3), lin_vel=np.zeros((3, 3)), gyro=np.zeros((3, 3)))
    commands = np.array([[0.3, 0.0, 0.0], [0.03, 0.0, -0.02], [1.0, 0.0, 0.0]])
    frame = np.zeros((3, Go2WalkPolicy.FRAME), np.float32)
    for _ in range(50):
        task.label(frame, states, commands)
    np.testing.assert_allclose(asked[-1][0], [0.6, 0.0, 0.0], atol=0.01)
    np.testing.assert_array_equal(asked[-1][1], 0.0)  # a stick that does not rest at zero
    assert asked[-1][2, 0] == pytest.approx(1.2), "no more than a fifth beyond the range"
    task.forget(0)
    task.label(frame, states, commands)
    assert asked[-1][0, 0] < 0.32


def test_joints_that_are_not_driven_are_where_they_are_commanded_in_training_as_in_the_station() -> None:
    commands = commands_of(G1WalkPolicy, 2)
    commands[1, 3:] += 0.2
    targets = WalkTask(G1WalkPolicy, None, Recipe(robot="g1"), 0.793).targets(np.zeros((2, 15), np.float32), commands)
    np.testing.assert_array_equal(targets[0], G1WalkPolicy.DEFAULT_Q)
    np.testing.assert_allclose(targets[1, 15:], G1WalkPolicy.DEFAULT_Q[15:] + 0.2)


def test_bodies_differ_in_their_rotors_where_the_recipe_says_so() -> None:
    config = CrowdRecipe(robots=3, bodies=3, nominal=1, armature=(0.005, 0.12))
    crowd = Crowd(GO2, [files.resolve(GO2.mjcf)], *Go2WalkPolicy.GAINS, config, np.random.default_rng(1), threads=1)
    try:
        rotors = [model.dof_armature[6] for model in crowd._models]
        assert rotors[0] == pytest.approx(0.1), "as its file says"
        assert all(0.005 <= rotor <= 0.12 for rotor in rotors)
        assert len(set(rotors)) == 3
        assert len(crowd.read().q[0]) == 12
    finally:
        crowd.close()
    assert len(G1.joints) == len(G1WalkPolicy.JOINTS)


TINY = """
robot: {robot}
teacher: zoo:policies/{teacher}.onnx
rounds: 2
steps_per_round: 20
batches_per_round: 5
polish_batches: 5
batch: 64
hidden: [32, 16]
crowd: {{robots: 4, bodies: 2}}
"""


@pytest.mark.torch
@pytest.mark.assets
@pytest.mark.usefixtures("assets")
@pytest.mark.parametrize(("robot", "teacher"), [("go2", "playground_go1_policy"), ("g1", "falcon_g1_29dof")])
def test_a_run_writes_a_policy_and_its_log(robot: str, teacher: str, tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(TINY.format(robot=robot, teacher=teacher))
    assert main(["--out", str(tmp_path), "--recipe", str(tmp_path / "tiny.yaml"), "--threads", "1"]) == 0
    policy = POLICIES[robot][0](tmp_path / "walk.onnx")
    assert np.isfinite(policy.act(np.zeros(policy.OBSERVATION, np.float32))).all()
    log = json.loads((tmp_path / "training.json").read_text())
    assert [entry["round"] for entry in log["rounds"]] == [1, 2, 2]
    assert log["facts"]["teacher_sha256"] == files.sha256(files.resolve(f"zoo:policies/{teacher}.onnx"))


@pytest.mark.torch
@pytest.mark.parametrize(
    ("recipe", "words"),
    [
        ("robot: h1", "Invalid enum value 'h1' - at `$.robot`"),
        ("robot: g1", "the recipe names no teacher; name with `teacher` in the recipe a copy of LeCAR-Lab/FALCON"),
        (
            "teacher: nowhere.onnx",
            "nowhere.onnx: no such file; name with `teacher` in the recipe a copy of google",
        ),
        ("teacher: builtin:go2.xml", "go2.xml: expected a teacher's ONNX network"),
    ],
)
def test_a_recipe_that_cannot_be_is_refused_in_a_line(
    recipe: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.yaml").write_text(f"{recipe}\n")
    assert main(["--out", str(tmp_path), "--recipe", str(tmp_path / "bad.yaml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


def test_a_recipe_that_is_not_there_is_refused_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "none.yaml"
    assert main(["--out", str(tmp_path), "--recipe", str(path)]) == 2
    assert capsys.readouterr().err == f"error: {path}: No such file or directory; expected a recipe, a YAML file\n"
