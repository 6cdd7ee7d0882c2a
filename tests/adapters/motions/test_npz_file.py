from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.motions import npz_file
from adapters.robots.g1.joints import G1_25, G1_29
from station.errors import BadFile
from tests.adapters.motions.made import smooth

MOTION = smooth()


def save(path: Path, **changes: Any) -> Path:
    members = {
        "fps": MOTION.fps,
        "root_pos": MOTION.root_pos,
        "root_quat_wxyz": MOTION.root_quat_wxyz,
        "joint_pos": MOTION.q,
        "joint_names": G1_29,
    }
    npz_file.save(path, **{**members, **changes})
    return path


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    raw = npz_file.load(save(tmp_path / "walk.npz"))
    assert raw.fps == MOTION.fps
    np.testing.assert_array_equal(raw.root_pos, MOTION.root_pos)
    np.testing.assert_array_equal(raw.root_quat_wxyz, MOTION.root_quat_wxyz)
    np.testing.assert_array_equal(raw.q, MOTION.q)


def test_joints_are_found_by_name_in_any_order_with_or_without_suffix(tmp_path: Path) -> None:
    order = np.random.default_rng(1).permutation(29)
    names = [f"{G1_29[index]}_joint" for index in order]
    raw = npz_file.load(save(tmp_path / "a.npz", joint_pos=MOTION.q[:, order], joint_names=names))
    np.testing.assert_array_equal(raw.q, MOTION.q)


def test_wrists_may_be_absent_and_are_zero(tmp_path: Path) -> None:
    columns = [G1_29.index(name) for name in G1_25]
    raw = npz_file.load(save(tmp_path / "a.npz", joint_pos=MOTION.q[:, columns], joint_names=G1_25))
    assert raw.filled == ("left_wrist_pitch", "left_wrist_yaw", "right_wrist_pitch", "right_wrist_yaw")
    np.testing.assert_array_equal(raw.q[:, columns], MOTION.q[:, columns])


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"joint_names": [*G1_29[:-1], "tail"]}, "tail"),
        ({"joint_names": [*G1_29[:-1], G1_29[0]]}, "28 different"),
        ({"joint_names": G1_29[1:], "joint_pos": MOTION.q[:, 1:]}, "left_hip_pitch"),
        ({"fps": -1.0}, "fps"),
        ({"root_pos": MOTION.root_pos[:-1]}, "89"),
    ],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path: Path, change: dict[str, Any], expected: str) -> None:
    with pytest.raises(BadFile, match=expected):
        save(tmp_path / "bad.npz", **change)
    assert not (tmp_path / "bad.npz").exists()


def test_bad_archives_are_refused_in_one_line(tmp_path: Path) -> None:
    whole = save(tmp_path / "good.npz").read_bytes()
    path = tmp_path / "bad.npz"
    for data in (b"", b"text", whole[: len(whole) // 2], whole[:200] + bytes(100) + whole[300:]):
        path.write_bytes(data)
        with pytest.raises(BadFile) as refused:
            npz_file.load(path)
        assert "\n" not in str(refused.value)
        assert "bad.npz" in str(refused.value)


def test_a_missing_member_and_a_pickle_inside_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, fps=30.0)
    with pytest.raises(BadFile, match="root_pos"):
        npz_file.load(path)
    hidden = np.array([{}], dtype=object)
    np.savez(path, fps=30.0, root_pos=hidden, root_quat_wxyz=hidden, joint_pos=hidden, joint_names=hidden)
    with pytest.raises(BadFile, match=r"bad\.npz"):
        npz_file.load(path)


def test_an_archive_that_unpacks_to_gigabytes_is_refused_before_it_does(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("fps.npy", "w") as member:
        for _ in range(520):
            member.write(bytes(1 << 20))
    with pytest.raises(BadFile, match="unpacked"):
        npz_file.load(path)


def test_a_file_says_what_it_was_made_of(tmp_path: Path) -> None:
    assert npz_file.load(save(tmp_path / "plain.npz")).provenance == {}
    said = {"source": "walk.bvh", "fps": 50.0}
    assert npz_file.load(save(tmp_path / "made.npz", provenance=said)).provenance == said


@pytest.mark.parametrize(
    "foreign", [np.array("no JSON"), np.array("[1]"), np.array("[" * 10_000), np.zeros(3), np.array([{}], dtype=object)]
)
def test_a_member_of_that_name_that_somebody_else_wrote_is_ignored(tmp_path: Path, foreign: Any) -> None:
    path = save(tmp_path / "a.npz")
    with np.load(path) as members:
        np.savez(path, **members, provenance=foreign)
    assert npz_file.load(path).provenance == {}


def test_what_cannot_be_written_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "walk.npz").mkdir()
    with pytest.raises(OSError, match=r"walk\.npz"):
        save(tmp_path / "walk.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["walk.npz"]
