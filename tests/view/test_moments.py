"""Which moments a contact sheet shows."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29
from station.view.contact_sheet import instants, moments
from station.view.phases import Span
from station.view.poses import Posture
from station.view.run import Run


def run_of(phases: list[Span], *, seconds: float = 10.0, falls_s: list[float] | None = None) -> Run:
    times_ns = np.arange(0, int(seconds * 1e9), 20_000_000)
    root = np.tile([0.0, 0, 0.8, 1, 0, 0, 0], (len(times_ns), 1))
    return Run(
        episode_id="e", robot="g1", phases=phases, falls_s=falls_s or [],
        measured=Posture(times_ns, root, G1_29, np.zeros((len(times_ns), 29))),
    )  # fmt: skip


def test_each_clip_is_shown_and_longer_ones_more_often() -> None:
    clips = [Span(0, 1, "enter"), Span(1, 2, "wave"), Span(2, 8, "walk")]
    shown = moments(run_of(clips), 6)
    assert [moment.name for moment in shown] == ["enter", "wave", "walk", "walk", "walk", "walk"]
    assert [moment.at_s for moment in shown] == sorted(moment.at_s for moment in shown)


def test_blends_are_left_out_where_a_motion_plays() -> None:
    shown = moments(run_of([Span(0, 3, "entering"), Span(3, 5, "bow"), Span(5, 9, "leaving")]), 4)
    assert {moment.name for moment in shown} == {"bow"}


def test_without_a_motion_the_whole_recording_is_shown_evenly() -> None:
    at_s = [moment.at_s for moment in moments(run_of([]), 5)]
    assert at_s == pytest.approx([10 / 6, 20 / 6, 5.0, 40 / 6, 50 / 6], abs=0.05)


def test_more_clips_than_pictures_are_shown_evenly() -> None:
    parts = [Span(number, number + 1, f"clip{number}") for number in range(10)]
    assert instants(parts, 5).tolist() == [1.0, 3.0, 5.0, 7.0, 9.0]


def test_a_fall_is_shown() -> None:
    run = run_of([Span(0, 10, "walk")], falls_s=[5.5])
    assert run.measured is not None
    run.measured.root[275:, 3:] = (0.6, 0.8, 0, 0)
    shown = moments(run, 4)
    assert any(moment.has_fallen and moment.at_s == pytest.approx(6.3, abs=0.03) for moment in shown)
    assert not shown[0].has_fallen


def test_postures_that_are_not_whole_are_passed_over() -> None:
    run = run_of([Span(0, 10, "walk")])
    assert run.measured is not None
    run.measured.q[100:400] = np.nan
    rows = [moment.row for moment in moments(run, 5)]
    assert np.isfinite(run.measured.q[rows]).all()
    run.measured.root[:] = np.nan
    assert moments(run, 5) == []


def test_a_short_run_shows_no_posture_twice() -> None:
    rows = [moment.row for moment in moments(run_of([], seconds=0.06), 15)]
    assert rows
    assert len(set(rows)) == len(rows) <= 3
