"""A person from a BVH file: whatever names, units, axes and zero pose its writer chose."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.captures.load import load
from station.errors import BadFile
from tests.adapters.captures import written
from tests.adapters.captures.people import moving, place_error_m, turn_error_rad

Z_UP = np.eye(3)
X_UP = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
MADE: dict[str, dict[str, Any]] = {
    "Mixamo, y up, cm": {"prefix": "mixamorig:"},
    "Xsens, z up, mm": {"names": written.XSENS, "world": Z_UP, "unit_m": 0.001, "order": "YXZ"},
    "SMPL, x up, m": {"names": written.SMPL, "world": X_UP, "unit_m": 1.0, "order": "YZX"},
    "Blender, inches": {"names": written.BLENDER, "unit_m": 0.0254, "order": "XYZ"},
    "CMU's unit": {"unit_m": 0.0254 / 0.45, "order": "ZYX"},
    "arms hang at zero": {"zero": "hanging", "order": "XZY"},
    "upside down": {"world": UPSIDE_DOWN},
}


@pytest.mark.parametrize("name", MADE)
def test_the_person_comes_back(tmp_path: Path, name: str) -> None:
    person = moving("walk-forward", 1.0)
    found = load(written.write_bvh(tmp_path / "a.bvh", person, **MADE[name]))
    assert max(place_error_m(found.person, person).values()) < 1e-4
    assert max(turn_error_rad(found.person, person).values()) < 1e-4
    assert found.person.height_m == pytest.approx(1.72, abs=0.01)
    assert found.fps == pytest.approx(90.0)


def test_what_sits_on_bones_is_fitted_where_the_zero_pose_is_no_person(tmp_path: Path) -> None:
    """As in LAFAN1. The mean posture counts as upright: an elbow's axis differs by what wrists twist."""
    person = moving("walk-forward", 1.0)
    found = load(written.write_bvh(tmp_path / "a.bvh", person, zero="none"))
    assert max(place_error_m(found.person, person).values()) < 1e-4
    assert max(turn_error_rad(found.person, person).values()) < 0.15
    assert any("fitted to all frames" in note for note in found.notes)


def test_a_person_begins_at_the_origin_looks_along_x_and_stands_on_the_floor(tmp_path: Path) -> None:
    person = moving("walk-arc", 0.5)
    found = load(written.write_bvh(tmp_path / "a.bvh", person)).person
    np.testing.assert_allclose(found.positions[0, 0, :2], 0.0, atol=1e-9)
    forward = found.quats_wxyz[0, 0]
    assert abs(2.0 * np.arctan2(forward[3], forward[0])) < 1e-6
    assert 0.0 < found.positions[:, [10, 11], 2].min() < 0.03


def test_guesses_are_told_and_what_the_user_says_goes_before(tmp_path: Path) -> None:
    path = written.write_bvh(tmp_path / "a.bvh", moving("wave", 0.5))
    guessed = load(path)
    assert guessed.unit == "cm"
    assert any(note.startswith("lengths taken for cm: the person is 1.72 m tall") for note in guessed.notes)
    assert "y is up" in guessed.notes
    said = load(path, height_m=1.5)
    assert said.person.height_m == pytest.approx(1.5, abs=1e-3)
    assert not any("lengths taken" in note for note in said.notes)
    with pytest.raises(BadFile, match=r"the person is 172 m tall in m, expected 1\.2 to 2\.2 m"):
        load(path, units="m")


def test_a_skeleton_that_no_unit_makes_a_person_is_refused(tmp_path: Path) -> None:
    path = written.write_bvh(tmp_path / "a.bvh", moving("wave", 0.5), unit_m=0.3)
    with pytest.raises(
        BadFile, match=r"the skeleton is 5\.73\d tall; no unit of m, cm, mm, inch, cmu makes 1\.2 to 2\.2"
    ):
        load(path)
    assert load(path, height_m=1.72).unit == "scaled to 1.72 m"


def test_joints_at_one_place_are_no_person(tmp_path: Path) -> None:
    path = written.write_bvh(tmp_path / "a.bvh", moving("wave", 0.5))
    path.write_text(re.sub(r"OFFSET .*", "OFFSET 0 0 0", path.read_text()))
    for height_m in (None, 1.7):
        with pytest.raises(BadFile, match="all joints are at one place; expected a person"):
            load(path, height_m=height_m)


def test_a_mirrored_person_is_refused(tmp_path: Path) -> None:
    """Left-handed axes, or sides that are exchanged: it would walk backward."""
    swapped = {
        ours: theirs.translate(str.maketrans("LR", "RL")).replace("reft", "left")
        for ours, theirs in written.SMPL.items()
    }
    path = written.write_bvh(tmp_path / "a.bvh", moving("walk-forward", 1.0), names=swapped)
    with pytest.raises(BadFile, match="toes point backward by what left and right say"):
        load(path)


def test_a_joint_that_has_no_known_name_is_told_with_the_names_that_came(tmp_path: Path) -> None:
    names = written.MIXAMO | {"left_elbow": "LeftTentacle"}
    path = written.write_bvh(tmp_path / "a.bvh", moving("wave", 0.5), names=names)
    with pytest.raises(BadFile, match=r"no joint is the left elbow of a person; expected .*; came Hips, .*") as caught:
        load(path)
    assert "\n" not in str(caught.value)
