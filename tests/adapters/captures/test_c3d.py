"""Markers of Plug-in Gait from C3D files."""

from __future__ import annotations

import importlib.util
import random
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.captures import plug_in_gait
from adapters.captures.load import load
from adapters.retarget.human import INDEX, SIDES
from station.errors import BadFile, StationError
from tests.adapters.captures.people import moving, place_error_m, turn_error_rad
from tests.adapters.captures.written import c3d_bytes, markers_of, turns_of, write_c3d
from tests.examples import examples

needs_library = pytest.mark.skipif(importlib.util.find_spec("c3d") is None, reason="the extra c3d is not installed")

NEAR_M, NEAR_RAD = 0.008, 0.02
"""How near joints come that are known only by markers beside them."""

MADE: dict[str, dict[str, Any]] = {
    "floats, mm": {},
    "integers": {"scale": 0.25},
    "m": {"unit": "m", "unit_m": 1.0},
    "labels with a subject": {"prefix": "Ada:"},
    "no unit": {"unit": ""},
}


@needs_library
@pytest.mark.parametrize("name", MADE)
def test_the_person_comes_back(tmp_path: Path, name: str) -> None:
    person = moving("walk-forward", 1.0)
    found = load(write_c3d(tmp_path / "a.c3d", person, **MADE[name]))
    assert max(place_error_m(found.person, person).values()) < NEAR_M
    assert max(turn_error_rad(found.person, person).values()) < NEAR_RAD
    assert found.person.height_m == pytest.approx(1.72, abs=0.03)
    assert found.fps == pytest.approx(90.0)


@needs_library
def test_a_marker_that_is_hidden_for_a_moment_is_bridged_and_told(tmp_path: Path) -> None:
    """In a straight line: joints are a little off for that long."""
    person = moving("walk-forward")
    found = load(write_c3d(tmp_path / "a.c3d", person, hidden={"LKNE": slice(100, 120), "STRN": slice(40, 60)}))
    assert max(place_error_m(found.person, person).values()) < 2.0 * NEAR_M
    assert max(turn_error_rad(found.person, person).values()) < 5.0 * NEAR_RAD
    assert "hidden markers bridged, at the longest: STRN 0.22 s, LKNE 0.22 s" in found.notes


@needs_library
def test_fingers_head_and_one_of_the_trunk_may_be_absent(tmp_path: Path) -> None:
    """The chest leans as the breast bone does, then: a tenth of a radian."""
    person = moving("walk-forward")
    found = load(write_c3d(tmp_path / "a.c3d", person, left_out=["T10", "LFHD", "RBAK", "LFIN", "RFIN"]))
    assert max(place_error_m(found.person, person).values()) < NEAR_M
    off = turn_error_rad(found.person, person)
    assert off.pop("spine3") < 0.12
    assert off.pop("left_wrist") < 0.4
    assert off.pop("right_wrist") < 0.4
    assert max(off.values()) < NEAR_RAD


@needs_library
def test_a_capture_begins_where_all_markers_are_known(tmp_path: Path) -> None:
    path = write_c3d(tmp_path / "a.c3d", moving("wave"), hidden={"LASI": slice(0, 45), "RTOE": slice(200, 270)})
    found = load(path)
    assert len(found.person) == 155
    assert "begins 0.50 s later, where all markers are known" in found.notes


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_c3d(tmp_path / "a.c3d", moving("wave", 0.2))
    monkeypatch.setitem(sys.modules, "c3d", None)
    with pytest.raises(
        StationError, match=r"a C3D file needs c3d; install the extra: pip install 'teleop-station\[c3d\]'"
    ):
        load(path)


@needs_library
def test_two_people_in_one_file_are_told(tmp_path: Path) -> None:
    markers = markers_of(moving("wave", 0.5))
    labels = [f"{who}:{label}" for who in ("Ada", "Bob") for label in markers]
    points = np.concatenate([np.stack(list(markers.values()), axis=1)] * 2, axis=1)
    path = tmp_path / "two.c3d"
    path.write_bytes(c3d_bytes(labels, points, np.zeros(points.shape[:2]), 90.0, "m"))
    with pytest.raises(BadFile, match="marker C7 is there twice, as Ada:C7 and Bob:C7; expected those of one person"):
        load(path)


@needs_library
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"left_out": ["RELB"]}, "marker RELB is not in it, or hidden for too long; expected the labels of Plug-in"),
        ({"left_out": ["LPSI"]}, "marker LPSI and RPSI, or SACR is not in it"),
        ({"left_out": ["STRN", "T10"]}, "marker T10 or STRN is not in it"),
        ({"hidden": {"LKNE": slice(50, 150)}}, "marker LKNE is hidden for 1.11 s, 0.56 s in; at most 0.5 s are"),
        ({"hidden": {"LKNE": slice(0, 999)}}, "marker LKNE is seen in no frame"),
        ({"hidden": {"LKNE": slice(100, 999), "RKNE": slice(0, 200)}}, "there is no time in which all of"),
        ({"unit": "mm", "unit_m": 0.01}, "the person is 0.17"),
    ],
)  # fmt: skip
def test_what_is_missing_is_told_in_one_line(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    path = write_c3d(tmp_path / "a.c3d", moving("wave"), **changes)
    with pytest.raises(BadFile) as caught:
        load(path)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("clip", ["walk-forward", "wave", "squat"])
def test_markers_beside_joints_tell_where_the_joints_are(clip: str) -> None:
    """However far a limb is bent, to whichever side a hinge's marker is."""
    person = moving(clip, 1.0, 2.0)
    places, turns = plug_in_gait.joints(markers_of(person))
    for side in SIDES:
        for joint in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"):
            off_m = np.linalg.norm(places[f"{side}_{joint}"] - person.positions[:, INDEX[f"{side}_{joint}"]], axis=1)
            assert off_m.max() < NEAR_M, f"{side}_{joint}"
        for part, joint in (("foot", "ankle"), ("hand", "wrist")):
            known = turns_of(person)[:, INDEX[f"{side}_{joint}"]]
            np.testing.assert_allclose(turns[f"{side}_{part}"], known, atol=NEAR_RAD)


def test_a_sacrum_stands_for_the_back_of_the_pelvis() -> None:
    markers = markers_of(moving("wave"))
    sacrum = 0.5 * (markers["LPSI"] + markers["RPSI"])
    other = {name: points for name, points in markers.items() if name not in ("LPSI", "RPSI")} | {"SACR": sacrum}
    (_, turns), (_, same) = (plug_in_gait.joints(each) for each in (markers, other))
    np.testing.assert_allclose(turns["pelvis"], same["pelvis"])


@needs_library
def test_a_damaged_file_raises_one_line_and_ends_nothing(tmp_path: Path) -> None:
    """Whatever bytes are wrong: each file is read, or refused in a line."""
    whole = write_c3d(tmp_path / "a.c3d", moving("wave", 0.5)).read_bytes()
    chance, path, told = random.Random(0), tmp_path / "b.c3d", []
    for _ in range(examples(200)):
        damaged = bytearray(whole[: chance.choice([len(whole), chance.randrange(len(whole))])])
        for _ in range(chance.choice([1, 2, 8])):
            damaged[chance.randrange(min(len(damaged), 1800))] = chance.choice([0, 127, 128, 255])
        path.write_bytes(damaged)
        try:
            load(path)
        except BadFile as error:
            told.append(str(error))
    assert len(told) > 10
    assert [line for line in told if not line.startswith(f"{path}: ") or "\n" in line] == []
