from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.motions.bad_frames import Limits, mend
from station import rotations
from station.errors import BadFile
from tests.adapters.motions.made import smooth, spoiled
from tests.examples import examples

GOOD = smooth()
LAST = len(GOOD) - 1
HIGH = GOOD.root_pos[0] + np.array([0, 0, 1.0])


def test_good_frames_are_left_as_they_are() -> None:
    mended, report = mend(GOOD)
    assert report.lines() == []
    assert (report.first, report.last) == (0, LAST)
    np.testing.assert_array_equal(mended.q, GOOD.q)


def test_a_root_a_metre_too_high_at_the_start_is_trimmed_and_reported_by_number_and_value() -> None:
    mended, report = mend(spoiled(GOOD, root_pos={0: HIGH}))
    assert report.trimmed == (1, 0)
    assert len(mended) == LAST
    assert any("frames 0->1: root climb 29." in line and "limit 4.5" in line for line in report.lines())
    assert report.facts()["trimmed"] == {"start": 1, "end": 0}


def test_bad_ends_are_trimmed_on_both_sides_also_when_several_frames_are_bad() -> None:
    bad = spoiled(GOOD, root_pos={range(3): HIGH}, q={range(LAST - 1, LAST + 1): 3.0})
    _, report = mend(bad)
    assert report.trimmed == (3, 2)


def test_a_long_end_without_numbers_is_trimmed() -> None:
    _, report = mend(spoiled(GOOD, q={range(40, LAST + 1): np.nan}))
    assert report.trimmed == (0, 50)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"root_pos": {40: HIGH}}, "root speed"),
        ({"root_pos": {40: [np.nan, 0, 0.8]}}, "root position[0] nan"),
        ({"root_quat_wxyz": {40: np.zeros(4)}}, "norm of the root quaternion 0"),
        ({"root_quat_wxyz": {40: rotations.from_rotation_vector([0.0, 0.0, 3.0])}}, "root turn rate"),
        ({"q": {(40, 18): 2.0}}, "speed of left_elbow"),
        ({"q": {(40, 18): np.inf}}, "left_elbow inf"),
    ],
)
def test_a_hole_inside_is_refused_by_number_and_value_or_bridged_by_choice(
    change: dict[str, Any], expected: str
) -> None:
    bad = spoiled(GOOD, **change)
    with pytest.raises(BadFile) as refused:
        mend(bad)
    assert expected in str(refused.value)
    assert "bad frames 40 " in str(refused.value)
    mended, report = mend(bad, holes="bridge")
    assert report.bridged == ((40, 40),)
    np.testing.assert_allclose(mended.root_pos[40], (GOOD.root_pos[39] + GOOD.root_pos[41]) / 2)
    np.testing.assert_allclose(mended.q[40], (GOOD.q[39] + GOOD.q[41]) / 2)
    halfway = rotations.slerp(GOOD.root_quat_wxyz[39], GOOD.root_quat_wxyz[41], 0.5)
    np.testing.assert_allclose(mended.root_quat_wxyz[40], halfway, atol=1e-12)


def test_two_holes_are_bridged_and_the_last_frames_still_trimmed() -> None:
    bad = spoiled(GOOD, root_pos={20: HIGH, range(50, 53): HIGH, LAST: HIGH})
    _, report = mend(bad, holes="bridge")
    assert report.bridged == ((20, 20), (50, 52))
    assert report.trimmed == (0, 1)


def test_a_hole_longer_than_a_second_is_not_bridged() -> None:
    bad = spoiled(GOOD, q={range(30, 61): np.nan})
    with pytest.raises(BadFile, match="longer than the 1 s"):
        mend(bad, holes="bridge")


def test_two_takes_in_one_file_are_refused_not_trimmed() -> None:
    shifted = GOOD.root_pos[45:] + np.array([3.0, 0, 0])
    for holes in ("refuse", "bridge"):
        with pytest.raises(BadFile, match="cut the file in two"):
            mend(spoiled(GOOD, root_pos={range(45, LAST + 1): shifted}), holes=holes)


def test_a_file_without_usable_frames_is_refused() -> None:
    with pytest.raises(BadFile, match="0 of 90 frames"):
        mend(spoiled(GOOD, root_quat_wxyz={range(LAST + 1): 0.0}))


def test_joints_beyond_their_range_are_reported_and_not_refused() -> None:
    q = GOOD.q.copy()
    q[10:20, 18] += 2.2
    q[:10, 18], q[20:, 18] = q[10, 18], q[19, 18]
    mended, report = mend(spoiled(GOOD, q={range(LAST + 1): q}))
    assert len(report.violations) == 1
    assert "left_elbow is beyond its range" in report.lines()[0]
    np.testing.assert_array_equal(mended.q, q)


def test_quaternions_that_are_nearly_of_unit_length_are_made_so() -> None:
    mended, report = mend(spoiled(GOOD, root_quat_wxyz={range(LAST + 1): GOOD.root_quat_wxyz * 1.01}))
    assert report.findings == ()
    np.testing.assert_allclose(np.linalg.norm(mended.root_quat_wxyz, axis=1), 1.0)


frames = st.integers(0, LAST)
numbers = st.one_of(st.floats(), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e300]))


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["root_pos", "root_quat_wxyz", "q"]), frames, numbers), max_size=6))
def test_whatever_is_spoiled_what_comes_out_is_good_or_refused(changes: list[tuple[str, int, float]]) -> None:
    bad = GOOD
    for name, frame, value in changes:
        bad = spoiled(bad, **{name: {frame: value}})
    try:
        mended, _ = mend(bad, holes="bridge")
    except BadFile:
        return
    _, report = mend(mended)
    assert report.findings == ()
    assert np.abs(np.diff(mended.q, axis=0)).max() * mended.fps <= Limits().joint_speed * (1 + 1e-9)
