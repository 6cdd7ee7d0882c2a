"""A body in, a reference out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adapters.commands.twist2 import FORMAT
from adapters.motions.load import load
from adapters.retarget.body_ik import Limits
from adapters.retarget.calibration import of_person
from adapters.retarget.evaluate import evaluate
from adapters.retarget.human import INDEX, standing
from adapters.retarget.ik_tasks import Weights
from adapters.retarget.pipeline import BodyLost, BodyRetarget
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.operator.sample import Body
from station.protocols import Reference
from tests.adapters.retarget.people import ADULT, PERIOD_NS, doing, moved
from tests.examples import some

RETARGET = BodyRetarget(of_person(ADULT))


def fresh() -> BodyRetarget:
    RETARGET.reset()
    return RETARGET


@pytest.mark.parametrize(
    ("clip", "height_m", "legs_rad", "worst_rad"),
    some(
        [
            ("walk-forward", 1.9, 0.022, 0.3),
            ("squat", 1.5, 0.012, 0.08),
            ("turn-left", 1.5, 0.025, 0.3),
            ("wave", 1.9, 0.006, 0.08),
        ]
    ),
)
def test_what_a_person_imitates_comes_back(clip: str, height_m: float, legs_rad: float, worst_rad: float) -> None:
    score = evaluate(load(f"builtin:{clip}"), height_m)
    assert score.legs_rad < legs_rad
    assert score.arms_rad < 0.008
    assert score.worst_rad < worst_rad
    assert score.wrist_m < 0.01
    assert score.ankle_m < 0.02
    assert score.height_m < 0.01
    assert score.velocity_mps < 0.08
    assert score.yaw_rad_s < 0.2
    assert score.slide_mps < 0.01


def test_with_a_noisy_tracker_it_is_the_same_picture() -> None:
    score = evaluate(load("builtin:walk-forward"), 1.7, metres=0.002, radians=np.radians(1.0))
    assert score.legs_rad < 0.035
    assert score.arms_rad < 0.05
    assert score.slide_mps < 0.05
    assert score.velocity_mps < 0.12


def test_every_frame_is_a_command_that_the_gate_takes_as_it_is() -> None:
    retarget, person = fresh(), doing("walk-fast")
    for index in some(range(len(person))):
        reference = retarget.step(person.body(index), person.capture_ns(index))
        vector = FORMAT.encode(reference, retarget.joint_names)
        assert vector.shape == (35,)
        assert (vector >= FORMAT.lower).all()
        assert (vector <= FORMAT.upper).all()


def test_a_sample_seen_twice_is_the_same_reference_and_makes_no_spike() -> None:
    """A loop at 200 Hz over samples at 90 Hz gives what a loop at 90 Hz gives."""
    person, once, often = doing("walk-forward"), [], []
    retarget = fresh()
    for index in range(120):
        once.append(retarget.step(person.body(index), person.capture_ns(index)))
    retarget = fresh()
    for index in range(120):
        for _ in range(2):
            often.append(retarget.step(person.body(index), person.capture_ns(index)))
    assert all(first is second for first, second in zip(often[::2], often[1::2], strict=True))
    for mine, other in zip(often[::2], once, strict=True):
        np.testing.assert_array_equal(FORMAT.encode(mine, G1_29), FORMAT.encode(other, G1_29))


def test_velocities_are_by_the_devices_clock_not_by_ours() -> None:
    """The same motion at half the stamps' pace is a motion of half the speed."""
    person = doing("walk-forward")
    speeds = []
    for pace in (1, 2):
        retarget = fresh()
        found = [retarget.step(person.body(index), index * pace * PERIOD_NS) for index in range(400)]
        speeds.append(np.mean([reference.root_lin_vel[0] for reference in found[250:400]]))
    assert speeds[0] / speeds[1] == pytest.approx(2.0, rel=0.1)
    assert 0.4 < speeds[0] < 0.6


def commands_are_continuous(references: list[Reference]) -> None:
    vectors = np.array([FORMAT.encode(reference, G1_29) for reference in references])
    rates = np.abs(np.diff(vectors, axis=0)) / (PERIOD_NS * 1e-9)
    assert (rates[:, 6:] <= g1.velocity(G1_29) + 1e-6).all()
    assert (rates[:, 2] <= 2.5 * 1.001).all()
    assert (np.abs(vectors[:, :2]) <= 2.5 * np.sqrt(2) * 1.01).all()


@settings(max_examples=len(some(range(12))), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    shift=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.5, 0.5)),
    turn=st.floats(-3.0, 3.0),
    gap_ns=st.sampled_from([PERIOD_NS, 3 * PERIOD_NS, 2_000_000_000, -5_000_000_000]),
)
def test_a_headset_that_is_centred_anew_or_comes_back_moves_no_robot(
    shift: tuple[float, float, float], turn: float, gap_ns: int
) -> None:
    person, retarget = doing("walk-forward"), fresh()
    found, time_ns = [], 10**18
    for index in range(200, 320):
        time_ns += gap_ns if index == 260 else PERIOD_NS
        body = person.body(index)
        leapt = np.linalg.norm(shift) > 0.35 or abs(turn) > 0.9 or gap_ns not in (PERIOD_NS, 3 * PERIOD_NS)
        elsewhere = moved(body, shift, turn) if index >= 260 and leapt else body
        found.append(retarget.step(elsewhere, time_ns))
    commands_are_continuous(found)
    heights = [reference.root_pos[2] for reference in found]
    assert np.abs(np.diff(heights)).max() < 0.02
    speeds = np.array([reference.root_lin_vel[:2] for reference in found[20:]])
    assert np.linalg.norm(speeds, axis=1).max() < 1.2, "no faster than the walk"
    assert np.isfinite(speeds).all()


def test_an_arm_that_leaps_is_caught_up_with() -> None:
    retarget = fresh()
    bodies = [standing(ADULT, arms="down")] * 30 + [standing(ADULT, arms="out")] * 60
    found = [retarget.step(body, index * PERIOD_NS + 1) for index, body in enumerate(bodies)]
    commands_are_continuous(found)
    shoulder = G1_29.index("left_shoulder_roll")
    assert found[29].q[shoulder] < 0.2
    assert found[-1].q[shoulder] > 1.3


@pytest.mark.parametrize("period_ns", [5_000_000, 20_000_000])
def test_how_far_a_joint_goes_in_a_frame_is_by_the_devices_clock(period_ns: int) -> None:
    retarget = fresh()
    bodies = [standing(ADULT, arms="down")] * 20 + [standing(ADULT, arms="out")] * 40
    q = np.array([retarget.step(body, (index + 1) * period_ns).q for index, body in enumerate(bodies)])
    fastest = np.abs(np.diff(q, axis=0)).max() / (period_ns * 1e-9)
    assert fastest == pytest.approx(Limits().joint_rad_s, rel=1e-6)


@pytest.mark.parametrize("seed", some(range(4)))
def test_bodies_that_nobody_has_give_finite_joints_within_their_ranges(seed: int) -> None:
    retarget, random = fresh(), np.random.default_rng(seed)
    for index in range(120):
        quats = rotations.normalized(random.normal(size=(24, 4)))
        reference = retarget.step(Body(random.normal(size=(24, 3)), quats), index * PERIOD_NS + 1)
        everything = np.concatenate([np.ravel(getattr(reference, name)) for name in reference.__slots__])
        assert np.isfinite(everything).all()
        assert (reference.q >= g1.lower(G1_29)).all()
        assert (reference.q <= g1.upper(G1_29)).all()


def test_facts_tell_whose_body_it_is_and_how_late_the_layers_are() -> None:
    facts = fresh().facts()
    assert facts["calibrated"]["height_m"] == pytest.approx(1.72, abs=0.01)
    assert facts["latency_s"] == {"smoothing_at_1_mps": pytest.approx(0.0066, abs=1e-4), "velocity": 0.03}
    assert facts["ik"]["weights"]["foot"] == Weights().foot
    assert facts["lengths_m"]["thigh"] == pytest.approx(ADULT.thigh, abs=0.001)
    assert json.dumps(facts)


def broken(**changes: np.ndarray) -> Body:
    return replace(standing(ADULT), **changes)


_NAN = standing(ADULT).positions.copy()
_NAN[INDEX["left_wrist"], 1] = np.nan


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (None, "sees no body"),
        (broken(positions=np.zeros((24, 3))), "at one place"),
        (broken(positions=standing(ADULT).positions + 1e4), "hundred metres"),
        (broken(quats_wxyz=np.zeros((24, 4))), "pelvis has a quaternion of length 0.00"),
        (broken(positions=_NAN), "left_wrist of the body is not finite"),
        (broken(positions=np.zeros((23, 3))), r"shapes \(23, 3\)"),
    ],
)
def test_no_body_is_told_in_one_line_and_changes_nothing(body: Body | None, told: str) -> None:
    retarget, person = fresh(), doing("wave")
    for index in range(20):
        before = retarget.step(person.body(index), person.capture_ns(index))
    with pytest.raises(BodyLost, match=told) as caught:
        retarget.step(body, person.capture_ns(20))
    assert "\n" not in str(caught.value)
    after = retarget.step(person.body(20), person.capture_ns(20))
    assert np.abs(after.q - before.q).max() < 0.05
