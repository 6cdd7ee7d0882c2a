"""Parts of a motion by name, and what a motion is called."""

from __future__ import annotations

import pytest

from station.view.clips import Clip, clips, name_at, short_name

TOUR = {"duration_s": 9.0, "clips": [{"name": "wave", "start_s": 0.0, "end_s": 4.0}, {"name": "bow", "start_s": 5.0}]}


def test_a_clip_without_an_end_lasts_until_the_motion_ends() -> None:
    assert clips(TOUR) == [Clip("wave", 0.0, 4.0), Clip("bow", 5.0, 9.0)]


@pytest.mark.parametrize(("time_s", "name"), [(0.0, "wave"), (3.9, "wave"), (4.5, ""), (5.0, "bow"), (20.0, "")])
def test_the_clip_at_a_time_is_the_one_that_plays_then(time_s: float, name: str) -> None:
    assert name_at(clips(TOUR), time_s) == name


@pytest.mark.parametrize("facts", [{}, {"clips": "wave"}, {"clips": [1, {"name": "no start"}]}])
def test_facts_that_tell_of_no_clips_give_none(facts: dict[str, object]) -> None:
    assert clips(facts) == []


@pytest.mark.parametrize(
    ("reference", "name"),
    [
        ("builtin:tour", "tour"),
        ("twist2:motions/walk_001.pkl", "walk_001"),
        ("/lab/a.b/walk.npz", "walk"),
        ("builtin:wave#mirror,speed=1.2", "wave#mirror,speed=1.2"),
        ("", ""),
    ],
)
def test_a_motion_is_called_by_its_short_name(reference: str, name: str) -> None:
    assert short_name(reference) == name
