"""Which cases there are."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import pytest

from adapters.motions import builtin
from station.control.gate import GateConfig
from station.suite import clips, promise
from station.suite.cases import Arms, Case, Cut, Push, Stand, Track
from station.suite.promise import FULL, HELD_BACK, LIMITS, QUICK, SILENCES, Clips, cases

CLIPS = Clips(durations_s={"builtin:walk-fast": 8.0, "builtin:stand": 4.0, "x/walk.pkl": 9.5}, wave_s=6.0)

GROUPS = [group for group in LIMITS if group not in ("follow", "hand-over")]  # those are of velocities


def of(kind: type[Case], made: list[Case]) -> list[Case]:
    return [case for case in made if isinstance(case, kind)]


def test_every_case_has_a_name_of_its_own_and_a_group_of_the_table() -> None:
    made = cases(FULL, CLIPS)
    assert [name for name, count in Counter((case.group, case.name) for case in made).items() if count > 1] == []
    assert list(dict.fromkeys(case.group for case in made)) == GROUPS, "in the order of the table"


def test_the_whole_promise_of_the_tracker_is_there() -> None:
    made = cases(FULL, CLIPS)
    (stand,) = [case for case in of(Stand, made) if case.group == "stand"]
    assert stand.seconds == 600.0
    assert all(case.seconds == 600.0 for case in of(Arms, made))
    pushes = [(case.clip, case.speed_mps, round(math.degrees(case.towards_rad))) for case in of(Push, made)]  # type: ignore[attr-defined]
    directions = range(0, 360, 45)
    assert set(pushes) == {("", 0.4, k) for k in directions} | {("builtin:wave", 0.3, k) for k in directions}
    assert all(case.seconds - case.at_s == 5.0 for case in of(Push, made))  # type: ignore[attr-defined]
    assert {case.clip for case in of(Track, made)} == set(CLIPS.durations_s)  # type: ignore[attr-defined]
    late = [case for case in made if case.group == "late"]
    assert all(case.name.endswith(", 20 ms late") for case in late)
    assert [case.name.partition(",")[0] for case in late] == ["stand 60 s", "builtin:walk-fast", "walk.pkl"]


def test_each_silence_begins_once_a_second_of_every_clip_and_the_turns_lie_between_each_other() -> None:
    for clip, duration_s in CLIPS.durations_s.items():
        cuts = [case for case in cases(FULL, CLIPS) if isinstance(case, Cut) and case.clip == clip]
        assert {case.silence for case in cuts} == set(SILENCES)
        for silence in SILENCES:
            instants = [case.at_s for case in cuts if case.silence == silence]
            assert instants[0] < 1.0
            assert all(math.isclose(b - a, 1.0) for a, b in itertools.pairwise(instants))
            until_s = instants[-1] + (silence.seconds if silence.goes_on else 0.0)
            assert duration_s - 1.0 <= until_s < duration_s, "the commands come back before the clip ends"
        assert min(abs(a.at_s - b.at_s) for a in cuts for b in cuts if a is not b) > 0.3


def test_silences_end_in_the_state_of_the_gate_that_they_are_named_after() -> None:
    gate = GateConfig()
    seconds = {silence.name: silence.seconds for silence in SILENCES}
    assert gate.hold_after_s < seconds["holding"] < gate.return_after_s
    assert gate.return_after_s < seconds["returning"] < gate.return_after_s + gate.blend_out_s
    assert seconds["standing"] >= gate.return_after_s + gate.blend_out_s + 1.0


def test_groups_can_be_picked_and_the_quick_extent_has_every_kind_of_case() -> None:
    assert {case.group for case in cases(FULL, CLIPS, ["push", "arms"])} == {"push", "arms"}
    quick, full = cases(QUICK, CLIPS), cases(FULL, CLIPS)
    assert {case.group for case in quick} == set(GROUPS)
    assert sum(case.seconds for case in quick) < 0.3 * sum(case.seconds for case in full)


def test_what_the_motions_hold_back_from_training_is_what_counts_as_unseen() -> None:
    built_in = {name.removeprefix("builtin:") for name in HELD_BACK if name.startswith("builtin:")}
    assert built_in == set(builtin.HELD_BACK)
    groups = {case.clip: case.group for case in cases(QUICK, CLIPS) if isinstance(case, Track) and not case.late_s}
    assert groups["builtin:walk-fast"] == "unseen"
    assert groups["builtin:stand"] == "track"


def test_without_upstream_data_its_clips_are_named_as_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATION_ASSETS", raising=False)
    found, missing = clips.find()
    assert {name for name in found.durations_s if not name.startswith("builtin:")} == set()
    assert {f"builtin:{name}" for name in builtin.names()} == set(found.durations_s)
    assert set(promise.UPSTREAM) < set(missing)


def test_the_users_clips_take_the_place_of_all_others() -> None:
    found, missing = clips.find(["builtin:bow", "builtin:bow#speed=0.5"])
    assert found.durations_s["builtin:bow#speed=0.5"] == pytest.approx(2.0 * found.durations_s["builtin:bow"])
    assert len(found.durations_s) == 2
    assert missing == []
