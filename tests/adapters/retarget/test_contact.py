"""Feet on the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adapters.motions.load import load
from adapters.retarget.calibration import of_person
from adapters.retarget.contact import SOLE_DEPTH_M, FootHold
from adapters.retarget.human import standing
from adapters.retarget.scaling import LinkTargets, Scaler
from tests.adapters.retarget.people import ADULT, doing

DT_S = 1.0 / 90.0
STILL = Scaler(of_person(ADULT)).step(standing(ADULT))


def shifted(
    aim: LinkTargets, soles: tuple[float, float] = (0.0, 0.0), step: tuple[float, float, float] = (0, 0, 0)
) -> LinkTargets:
    """Return an aim whose soles are higher and whose feet have gone somewhere [m]."""
    by = np.array(step)
    return replace(aim, soles=aim.soles + soles, ankles=aim.ankles + by, steps=aim.steps + by)


def settled(hold: FootHold, frames: int = 60) -> LinkTargets:
    for _ in range(frames):
        held = hold.step(STILL, DT_S)
    return held


def test_a_trembling_foot_that_stands_is_held_still() -> None:
    hold, random = FootHold(), np.random.default_rng(0)
    settled(hold)
    before = settled(hold).ankles
    for _ in range(200):
        held = hold.step(shifted(STILL, step=tuple(random.normal(scale=0.0005, size=3))), DT_S)
        np.testing.assert_allclose(held.ankles, before, atol=1e-12)
    assert hold.carries.all()


def test_a_foot_that_is_lifted_is_let_go_without_a_jump() -> None:
    hold = FootHold()
    last = settled(hold).ankles
    for frame in range(40):
        up = 0.005 * frame
        held = hold.step(
            replace(
                STILL,
                soles=STILL.soles + np.array([up, 0.0]),
                ankles=STILL.ankles + np.array([[0.01 * frame, 0.0, up], [0.0, 0.0, 0.0]]),
            ),
            DT_S,
        )
        assert np.abs(held.ankles - last).max() < 0.04
        last = held.ankles
    assert hold.carries.tolist() == [False, True]
    np.testing.assert_allclose(held.ankles[0], STILL.ankles[0] + (0.39, 0.0, 0.195), atol=1e-9)


def test_a_held_foot_is_flat_and_at_the_height_of_its_sole() -> None:
    held = settled(FootHold())
    np.testing.assert_allclose(held.ankles[:, 2], SOLE_DEPTH_M, atol=1e-9)
    np.testing.assert_allclose(held.feet_turn[:, 2, 2], 1.0, atol=1e-12)


def test_both_feet_off_the_floor_lift_the_body_by_as_much() -> None:
    hold = FootHold()
    settled(hold)
    jumped = hold.step(shifted(STILL, soles=(0.2, 0.25), step=(0.0, 0.0, 0.2)), DT_S)
    assert 0.1 < jumped.pelvis[2] - STILL.pelvis[2] <= 0.2


def test_a_floor_that_drifts_is_followed_and_a_step_of_stairs_is_a_new_floor() -> None:
    hold = FootHold()
    settled(hold)
    for frame in range(600):
        drifted = hold.step(shifted(STILL, soles=(0.0002 * frame,) * 2), DT_S)
    assert hold.carries.all()
    assert abs(drifted.pelvis[2] - STILL.pelvis[2]) < 0.01


def test_contact_of_a_walk_is_that_of_the_clip() -> None:
    """The feet that the clip holds still carry, up to the moments at which they come and go."""
    motion, person = load("builtin:walk-forward"), doing("walk-forward")
    scaler, hold = Scaler(of_person(ADULT)), FootHold()
    seen, truth = [], []
    times = person.times_s.tolist()
    for index, time_s in enumerate(times):
        hold.step(scaler.step(person.body(index)), DT_S)
        seen.append(hold.carries.copy())
        truth.append(_stands(motion, time_s))
    agree = (np.array(seen) == np.array(truth)).mean()
    assert agree > 0.9


def _stands(motion, time_s: float) -> list[bool]:  # type: ignore[no-untyped-def]
    from adapters.robots.g1 import kinematics

    near = [motion.at(time_s + shift) for shift in (-0.005, 0.005)]
    links = kinematics.forward(
        *(np.array([getattr(one, name) for one in near]) for name in ("root_pos", "root_quat_wxyz", "q"))
    )
    feet = [links.position[kinematics.INDEX[f"{side}_ankle_roll"]] for side in ("left", "right")]
    return [bool(np.linalg.norm(foot[1] - foot[0]) < 1e-4) for foot in feet]
