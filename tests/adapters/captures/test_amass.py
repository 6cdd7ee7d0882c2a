"""AMASS and SMPL-X archives: rotations put onto a skeleton of ours."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.captures import amass
from adapters.captures.load import load
from station.bus.joints import SMPL_24
from station.errors import BadFile
from tests.adapters.captures.people import moving, place_error_m, turn_error_rad
from tests.adapters.captures.written import Y_UP, amass_members, turns_of, vectors, write_amass


def test_the_person_comes_back(tmp_path: Path) -> None:
    person = moving("walk-forward", 1.0)
    found = load(write_amass(tmp_path / "a.npz", person), height_m=1.72)
    assert max(place_error_m(found.person, person).values()) < 1e-6
    assert max(turn_error_rad(found.person, person).values()) < 1e-6
    assert found.fps == pytest.approx(90.0)


def test_the_zero_pose_is_a_t_pose_with_legs_a_little_apart() -> None:
    """x left, y up, z forward: hips below the pelvis, arms out, the left side to the left, and both sides alike."""
    at = dict(zip(SMPL_24, amass.rest(1.7), strict=False))
    assert at["left_knee"][0] > at["left_hip"][0] + 0.02
    assert at["left_ankle"][2] < at["left_knee"][2] - 0.03
    assert at["left_elbow"][0] > at["left_shoulder"][0] + 0.2
    assert at["left_foot"][2] > at["left_ankle"][2] + 0.1
    assert at["head"][1] > 0.4
    assert 0.0 > at["left_hip"][1] > at["left_knee"][1] > at["left_ankle"][1]
    for name, place in at.items():
        if name.startswith("left_"):
            np.testing.assert_allclose(at[name.replace("left", "right")], place * (-1.0, 1.0, 1.0), atol=1e-12)


def test_the_newer_members_say_the_same(tmp_path: Path) -> None:
    person = moving("wave")
    poses = amass_members(person)["poses"]
    split = {
        "poses": None, "root_orient": poses[:, :3], "pose_body": poses[:, 3:66], "mocap_framerate": None,
        "mocap_frame_rate": np.array(90.0), "surface_model_type": np.array("smplx"),
    }  # fmt: skip
    one, other = (load(write_amass(tmp_path / "a.npz", person, **changes)).person for changes in ({}, split))
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-9)


def test_a_world_with_y_up_is_turned(tmp_path: Path) -> None:
    person = moving("walk-forward", 1.0)
    members = amass_members(person)
    root = vectors(Y_UP @ turns_of(person)[:, 0] @ Y_UP.T)
    poses = np.concatenate([root, members["poses"][:, 3:]], axis=1)
    path = write_amass(tmp_path / "a.npz", person, poses=poses, trans=members["trans"] @ Y_UP.T)
    assert max(place_error_m(load(path, height_m=1.72).person, person).values()) < 1e-6


@pytest.mark.parametrize(
    ("gender", "tall_m"),
    [(np.array("female"), 1.63), (np.array(b"male"), 1.76), (np.array(["neutral"]), 1.70), (None, 1.70),
     (np.array({"a": 1}, dtype=object), 1.70)],
)  # fmt: skip
def test_without_a_height_the_gender_decides_and_it_is_told(tmp_path: Path, gender: Any, tall_m: float) -> None:
    found = load(write_amass(tmp_path / "a.npz", moving("wave"), gender=gender))
    assert found.person.height_m == pytest.approx(tall_m, abs=0.005)
    assert any("the shape of the body is not read: a mean skeleton of" in note for note in found.notes)


def _with(name: str, at: Any, value: float) -> dict[str, Any]:
    array = np.array(amass_members(moving("wave"))[name])
    array[at] = value
    return {name: array}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"poses": None}, "no member 'root_orient'; expected poses, trans and mocap_framerate"),
        ({"trans": None}, "no member 'trans'"),
        ({"mocap_framerate": None}, "no rate; expected one number"),
        ({"mocap_framerate": np.array(0.0)}, "0 frames per second; expected 5 to 2000"),
        ({"poses": np.zeros((270, 63))}, "expected 3 numbers for each of 22 joints or more"),
        ({"poses": np.zeros((99, 156))}, "99 poses and 270 places"),
        ({"poses": np.array(["a"])}, "poses is <U1 of shape"),
        (_with("poses", (7, 5), np.nan), "poses is not finite in frame 7 of 270"),
        (_with("poses", (7, 5), 90.0), "expected rotation vectors in radians, not degrees"),
        ({"poses": np.array([{"a": 1}], dtype=object)}, "not a readable AMASS file"),
        ({"poses": None, "joint_pos": np.zeros(3)}, "a motion of a robot, which `station rehearse` plays as it is"),
    ],
)
def test_a_file_that_is_none_is_told_in_one_line(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    path = write_amass(tmp_path / "a.npz", moving("wave"), **changes)
    with pytest.raises(BadFile) as caught:
        load(path)
    assert told in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_an_archive_that_unpacks_without_end_is_not_unpacked(tmp_path: Path) -> None:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("poses.npy", b"\0" * 10)
    bomb = content.getvalue().replace((10).to_bytes(4, "little"), (2_000_000_000).to_bytes(4, "little"))
    path = tmp_path / "bomb.npz"
    path.write_bytes(bomb)
    with pytest.raises(BadFile, match="2000 MB unpacked, at most"):
        load(path)
