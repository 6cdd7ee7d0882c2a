"""The inverse kinematics keeps its promises, whatever is asked of it."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adapters.retarget.body_ik import MODEL, START, BodyIK, Limits
from adapters.retarget.bone_frames import directed
from adapters.retarget.calibration import of_person
from adapters.retarget.human import SIDES, standing
from adapters.retarget.scaling import LinkTargets, Scaler, matrices
from adapters.robots.g1 import joints as g1
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station import assets, rotations
from station.errors import StationError
from station.protocols import Floats
from tests.adapters.retarget.people import ADULT

LOWER, UPPER = g1.lower(G1_29), g1.upper(G1_29)
IK = BodyIK()  # one for all: it is reset where that matters


def anything(seed: int) -> LinkTargets:
    """Return an aim that no body has: every direction and place is anywhere."""
    random = np.random.default_rng(seed)

    def turns(*shape: int) -> Floats:
        return matrices(rotations.normalized(random.normal(size=(*shape, 4))))

    def directions() -> Floats:
        return directed(random.normal(size=(2, 3)))

    return LinkTargets(
        pelvis=random.normal(size=3) * 3.0, pelvis_turn=turns(), chest_turn=turns(), thighs=directions(),
        ankles=random.normal(size=(2, 3)) * 3.0, feet_turn=turns(2), upper_arms=directions(), forearms=directions(),
        hands_turn=turns(2), soles=np.zeros(2), steps=np.zeros((2, 3)),
    )  # fmt: skip


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(seeds=st.lists(st.integers(0, 10_000), min_size=1, max_size=6), dt_s=st.floats(0.001, 0.3))
def test_limits_hold_and_nothing_leaps_whatever_is_asked(seeds: list[int], dt_s: float) -> None:
    limits = Limits()
    IK.reset()
    last = IK.step(anything(0), dt_s)
    for seed in seeds:
        for _ in range(3):
            now = IK.step(anything(seed), dt_s)
            assert np.isfinite(now).all()
            assert (now[7:] >= LOWER).all()
            assert (now[7:] <= UPPER).all()
            assert np.linalg.norm(now[3:7]) == pytest.approx(1.0)
            time_s = min(dt_s, limits.longest_s)
            fastest = np.minimum(g1.velocity(G1_29), limits.joint_rad_s)
            assert (np.abs(now[7:] - last[7:]) <= fastest * time_s + 1e-9).all()
            assert (np.abs(now[:3] - last[:3]) <= limits.root_mps * time_s + 1e-6).all()
            turned = rotations.rotation_vector(rotations.multiply(rotations.inverse(last[3:7]), now[3:7]))
            assert np.linalg.norm(turned) <= np.sqrt(3) * limits.root_rad_s * time_s + 1e-6
            last = now


def test_a_frame_without_time_changes_nothing() -> None:
    IK.reset()
    first = IK.step(anything(1), 0.01)
    np.testing.assert_allclose(IK.step(anything(2), 0.0), first, atol=1e-9)


def test_the_first_frame_is_met_at_once() -> None:
    """Somebody who begins in a deep lunge far from where the robot was modelled."""
    aim = Scaler(of_person(ADULT)).step(standing(ADULT, heading_rad=2.5, at=(4.0, -7.0)))
    IK.reset()
    first = IK.step(aim, 0.01)
    for _ in range(200):
        later = IK.step(aim, 0.01)
    np.testing.assert_allclose(first, later, atol=2e-3)
    np.testing.assert_allclose(first[:3], aim.pelvis, atol=0.005)


def test_a_t_pose_is_one() -> None:
    IK.reset()
    found = IK.step(Scaler(of_person(ADULT)).step(standing(ADULT, arms="out")), 0.01)
    links = kinematics.forward(found[None, :3], found[None, 3:7], found[None, 7:])
    for side, outward in (("left", 1.0), ("right", -1.0)):
        shoulder, elbow, wrist = (
            links.position[kinematics.INDEX[f"{side}_{link}"], 0] for link in ("shoulder_roll", "elbow", "wrist_pitch")
        )
        for bone in (elbow - shoulder, wrist - elbow):
            assert outward * bone[1] / np.linalg.norm(bone) > 0.999
        palm = links.rotation[kinematics.INDEX[f"{side}_wrist_yaw"], 0] @ [0.0, -outward, 0.0]
        assert palm[2] < -0.99
    np.testing.assert_allclose(links.position[kinematics.INDEX["left_ankle_roll"], 0, 2], 0.035, atol=0.002)
    assert 0.1 < found[7 + G1_29.index("left_knee")] < 0.3, "knees that lock cannot push"


def raised(*ways: tuple[float, float, float]) -> list[LinkTargets]:
    """Return the frames of somebody who moves both arms alike, straight, from way to way at 1.5 rad/s; then rests."""
    still = Scaler(of_person(ADULT)).step(standing(ADULT, arms="down"))
    frames, mirror = [], np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])
    points = [directed(np.array(way, dtype=float)) for way in ways]
    for start, end in pairwise(points):
        angle = np.arccos(start @ end)
        for share in np.arange(0.0, 1.0, 1.5 / 90.0 / angle):
            arm = directed(start * np.sin((1.0 - share) * angle) + end * np.sin(share * angle)) * mirror
            frames.append(replace(still, upper_arms=arm, forearms=arm))
    return frames + [frames[-1]] * 150


_DOWN, _FORWARD, _SIDE, _UP = (0.0, 0.1, -1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.05, 0.1, 1.0)


@pytest.mark.parametrize(
    "ways", [(_DOWN, _FORWARD, _UP, _SIDE, _DOWN), (_DOWN, _SIDE, _UP, _FORWARD, _DOWN)], ids=["front up", "side up"]
)
def test_arms_that_go_up_one_way_and_down_another_are_down_again(ways: tuple[tuple[float, float, float], ...]) -> None:
    ik = BodyIK()
    found = np.array([ik.step(aim, 1.0 / 90.0) for aim in raised(*ways)])
    for side in range(2):
        assert ik.rescues[side].way == "follows"
        wrist = kinematics.INDEX[f"{SIDES[side]}_wrist_pitch"]
        links = kinematics.forward(found[-1:, :3], found[-1:, 3:7], found[-1:, 7:])
        arm = links.position[wrist, 0] - links.position[kinematics.INDEX[f"{SIDES[side]}_shoulder_roll"], 0]
        assert directed(arm)[2] < -0.95
    assert np.abs(np.diff(found[:, 7:], axis=0)).max() <= 15.0 / 90.0 + 1e-9


def test_arms_that_cross_the_body_stay_clear_of_it_and_of_each_other() -> None:
    clear, careless = (nearest_of_crossing(BodyIK(is_clear=is_clear)) for is_clear in (True, False))
    assert (careless < -0.01).mean() > 0.5
    assert careless.min() < -0.08
    assert (clear < 0.0).mean() < 0.1
    assert clear.min() > -0.03, "forearms laid on each other lengthwise; elsewhere nothing overlaps"


def nearest_of_crossing(ik: BodyIK) -> Floats:
    """Distance of the two nearest limbs in every frame of arms that cross in front of the body and through it [m]."""
    model = mujoco.MjModel.from_xml_path(str(assets.resolve(MODEL)))
    data = mujoco.MjData(model)
    still = Scaler(of_person(ADULT)).step(standing(ADULT, arms="down"))
    nearest = []
    for frame in range(400):
        swing, lift = np.sin(frame / 45.0), np.cos(frame / 30.0)
        upper = directed(np.array([[0.5 * lift, -0.4 * swing, -1.0], [0.5 * lift, 0.4 * swing, -1.0]]))
        fore = directed(np.array([[0.6, -1.0 - swing, 0.3 * lift], [0.6, 1.0 + swing, -0.3 * lift]]))
        data.qpos = ik.step(replace(still, upper_arms=upper, forearms=fore), 1.0 / 90.0)
        mujoco.mj_forward(model, data)
        bodies = model.geom_bodyid[data.contact.geom]
        nearest.append(data.contact.dist[(bodies != 0).all(axis=1)].min(initial=1.0))
    return np.array(nearest)


def test_a_reset_begins_where_it_is_told() -> None:
    qpos = START.copy()
    qpos[:2] = 1.0, 2.0
    IK.reset(qpos)
    aim = Scaler(of_person(ADULT)).step(standing(ADULT))
    assert np.isfinite(IK.step(aim, 0.01)).all()


@pytest.mark.parametrize("library", ["mink", "daqp"])
def test_a_missing_library_names_the_extra_to_install(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)  # how Python itself marks what cannot be imported
    with pytest.raises(StationError, match=rf"needs {library}; install the extra: .*\[retarget\]"):
        BodyIK()
