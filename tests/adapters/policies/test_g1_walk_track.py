"""A G1 that walks or tracks: each policy listens to its part of the command alone, and one hands over to the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.commands import twist2
from adapters.motions.load import load
from adapters.policies.g1_walk_track import TracksPolicy, WalksPolicy
from adapters.policies.holosoma import HolosomaPolicy
from adapters.policies.tracker.policy import TrackerPolicy
from adapters.robots.g1.joints import G1_29
from station import assets as files
from station import registry
from station.bus import keys
from station.control.control import ControlStep, StepRecord
from station.control.parted_path import samples_of
from station.control.rig import PolicyChoice, Rig, RigConfig, build
from station.errors import ConfigError
from station.motion.playback import Playback
from station.parts import parts_of
from station.protocols import Floats, RobotState
from tests.adapters.policies.inputs import inputs
from tests.adapters.policies.restored import expect_goes_on
from tests.adapters.policies.test_holosoma import FACTS
from tests.adapters.policies.velocity_inputs import onnx_file
from tests.control.parted_walk import ASAP, FALCON

TRACKER = files.resolve("builtin:tracker.onnx")
RLGYM = "zoo:policies/rlgym_g1_motion.pt"
STANDING = twist2.FORMAT.default
DT = 0.02


@pytest.fixture
def holosoma(tmp_path: Path) -> Path:
    return onnx_file(tmp_path / "walk.onnx", 100, 29, FACTS)


def both(count: int) -> list[tuple[RobotState, Floats]]:
    """States, and commands of velocities and a motion, shape (38,) each."""
    random = np.random.default_rng(8)
    return [(state, np.concatenate([random.uniform(-1, 1, 3), command])) for state, command in inputs(count)]


def test_each_is_the_policy_inside_with_its_part_of_the_command(holosoma: Path) -> None:
    pairs = (
        (WalksPolicy(holosoma, walk="holosoma"), HolosomaPolicy(holosoma), slice(0, 3)),
        (TracksPolicy(TRACKER), TrackerPolicy(TRACKER), slice(3, 38)),
    )
    for whole, inside, part in pairs:
        for state, command in both(5):
            observation = whole.observe(state, command)
            np.testing.assert_array_equal(observation, inside.observe(state, command[part]))
            action = whole.act(observation)
            np.testing.assert_array_equal(action, inside.act(observation))
            made, own = whole.targets(action, command), inside.targets(action, command[part])
            np.testing.assert_array_equal(made.q, own.q)
            np.testing.assert_array_equal(made.kp, own.kp)
    assert [(whole.spec.name, whole.spec.part) for whole, *_ in pairs] == [("g1-walks", "walk"), ("g1-tracks", "track")]
    assert {whole.spec.command for whole, *_ in pairs} == {"g1-walk-track"}


def test_it_goes_on_from_a_recorded_observation(holosoma: Path) -> None:
    expect_goes_on(*(WalksPolicy(holosoma, walk="holosoma") for _ in range(2)), both(6), is_run=True)
    expect_goes_on(TracksPolicy(TRACKER), TracksPolicy(TRACKER), both(6), is_run=False)


def test_each_part_has_a_key_of_its_own_and_the_velocities_the_range_of_who_walks(holosoma: Path) -> None:
    rig = build(RigConfig(robot="g1-mujoco", policy="g1-walks", checkpoint=str(holosoma),
                          policy_options={"walk": "holosoma"}))  # fmt: skip
    walk, track = parts_of(rig.command_format)
    assert [part.key for part in (walk, track)] == ["action_velocity_g1_29_walk", "action_motion_g1_29_track"]
    assert keys.action("motion_g1_29_track") == track.key
    np.testing.assert_array_equal(walk.upper, [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(track.upper, twist2.FORMAT.upper)
    assert not track.auxiliary, "stock keys are those of the robot that stock programs know"


@pytest.mark.parametrize(
    ("walk", "size", "behind"),
    [
        ("homie", 456, [0.74]),
        pytest.param("asap", 0, [0.74, *STANDING[-14:]], marks=pytest.mark.assets),
        pytest.param("falcon", 0, [0.74, 0, 0, 0, *STANDING[-14:]], marks=pytest.mark.assets),
    ],
)
def test_one_that_takes_a_height_a_torso_or_arms_walks_as_high_and_with_arms_as_in_a_stand(
    tmp_path: Path, request: pytest.FixtureRequest, walk: str, size: int, behind: list[float]
) -> None:
    file = (
        onnx_file(tmp_path / "homie.onnx", size, 12)
        if size
        else request.getfixturevalue("assets") / {"asap": ASAP, "falcon": FALCON}[walk].replace(":", "/")
    )
    whole, inside = WalksPolicy(file, walk=walk), registry.find("policy", walk)(file)
    names = inside.spec.joint_names
    known = [G1_29.index(name) for name in names]
    for state, command in both(5):
        own = np.array([*command[:3], *behind])
        seen = replace(state, q=state.q[known], dq=state.dq[known])
        observation = whole.observe(state, command)
        np.testing.assert_array_equal(observation, inside.observe(seen, own))
        made, theirs = whole.targets(whole.act(observation), command), inside.targets(inside.act(observation), own)
        np.testing.assert_array_equal(made.q[known], theirs.q)
    lower = whole.spec.command_lower
    assert lower is not None
    np.testing.assert_array_equal(lower[:3], inside.spec.command_lower[:3])
    np.testing.assert_array_equal(lower[3:], twist2.FORMAT.lower)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda path: WalksPolicy(TRACKER, walk="tracker"), "g1-walks: policy 'tracker' follows 'twist2' commands; "
         "expected 'velocity' or 'velocity-height' or 'velocity-posture' or 'g1-arms-velocity' or "
         "'g1-arms-velocity-height' or 'g1-arms-velocity-posture'"),
        (lambda path: TracksPolicy(path, track="holosoma"), "g1-tracks: policy 'holosoma' follows 'velocity' commands; "
                                                           "expected 'twist2'"),
        (lambda path: WalksPolicy(onnx_file(path.with_name("go1.onnx"), 48, 12), walk="playground-go1"),
         "g1-walks: policy 'playground-go1' drives another robot: a G1 has no joint FR_hip, FR_thigh, FR_calf, FL_hip"),
    ],
)  # fmt: skip
def test_what_does_not_fit_inside_is_refused_in_a_line(holosoma: Path, make: object, told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make(holosoma)  # type: ignore[operator]
    assert str(caught.value) == told


def test_a_motion_that_asks_for_another_pose_is_not_taken_over_in_the_middle() -> None:
    policy = TracksPolicy(TRACKER)
    ((state, command),) = both(1)
    state = replace(state, q=twist2.FORMAT.default[6:])
    command[3:] = twist2.FORMAT.default
    assert policy.why_not_take_over(state, command) == ""
    command[9 + G1_29.index("left_knee")] += 1.7
    assert "the motion asks left_knee to be 1.7 rad from where it is" in policy.why_not_take_over(state, command)


def test_a_policy_that_walks_does_not_take_over_in_a_squat(holosoma: Path) -> None:
    policy = WalksPolicy(holosoma, walk="holosoma")
    ((state, command),) = both(1)
    state = replace(state, q=policy.spec.default_q.copy())
    assert policy.why_not_take_over(state, command) == ""
    state.q[G1_29.index("right_elbow")] += 1.5
    assert policy.why_not_take_over(state, command) == "", "arms swing to where it has them"
    state.q[G1_29.index("left_knee")] += 1.3
    assert "left_knee is 1.3 rad from where it is when the robot stands" in policy.why_not_take_over(state, command)


class Hall:
    """A simulated G1 that one policy walks and another has do motions."""

    def __init__(self, walk: str, checkpoint: str) -> None:
        physics = {"physics_dt_s": 0.002}
        self.rig: Rig = build(RigConfig(
            robot="g1-mujoco", robot_options=physics, policy="g1-walks", checkpoint=checkpoint,
            policy_options={"walk": walk},
            policies={"track": PolicyChoice(policy="g1-tracks")},
        ))  # fmt: skip
        self.control: ControlStep = self.rig.control()
        self.now_s = 0.0

    def drive(self, seconds: float, velocity: Sequence[float], motion: str = "") -> list[StepRecord]:
        """Command both parts for some seconds; without a motion the second part stands."""
        whole = self.rig.command_format
        playback = Playback(load(motion), parts_of(whole)[1]) if motion else None
        records = []
        for _ in range(round(seconds / DT)):
            command = whole.default.copy()
            command[:3] = velocity
            if playback is not None:
                command[3:] = playback.step(DT).command
            record = self.control.step(self.control.sense(), samples_of(whole, command, self.now_s), self.now_s)
            assert record.fall is None, f"{record.policy} at {self.now_s:.2f} s"
            self.now_s += DT
            records.append(record)
        return records

    def switch(self, name: str) -> None:
        assert self.control.policies is not None
        self.control.policies.switch(name)


@pytest.mark.assets
@pytest.mark.usefixtures("assets")
@pytest.mark.parametrize(
    ("walk", "checkpoint"),
    [("g1-walk", "builtin:g1-walk.onnx"), pytest.param("rlgym-g1", RLGYM, marks=pytest.mark.torch)],
)
def test_it_walks_somewhere_bows_walks_on_and_walks_by_a_motion(walk: str, checkpoint: str) -> None:
    """The second is of legs alone: the other joints are held."""
    hall = Hall(walk, checkpoint)
    hall.drive(3.0, (0.5, 0.0, 0.0))
    hall.drive(1.0, (0.0, 0.0, 0.0))
    hall.switch("track")
    bowing = hall.drive(9.0, (0.0, 0.0, 0.0), "builtin:bow")
    assert bowing[-1].policy == "track"
    errors = [np.abs(each.state.q - each.decision.vector[9:]).mean() for each in bowing[100:]]
    assert np.mean(errors) < 0.06, "it does what the motion says"
    hall.switch("g1-walks")
    start = hall.drive(1.0, (0.5, 0.0, 0.0))[-1].state.root_pos
    end = hall.drive(2.0, (0.5, 0.0, 0.0))[-1].state.root_pos
    assert start is not None
    assert end is not None
    assert np.linalg.norm((end - start)[:2]) > 0.6, "it walks again"
    hall.switch("track")  # on the walk
    hall.drive(6.0, (0.0, 0.0, 0.0), "builtin:walk-arc")
