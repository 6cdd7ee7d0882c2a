from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.motions import csv_file
from station.errors import BadFile
from tests.adapters.motions.made import smooth, write_csv

MOTION = smooth()


def test_36_columns_are_root_quaternion_xyzw_and_joints_at_30_frames_per_second(tmp_path: Path) -> None:
    raw = csv_file.load(write_csv(tmp_path / "walk.csv", MOTION))
    assert raw.fps == 30.0
    np.testing.assert_allclose(raw.root_pos, MOTION.root_pos, atol=1e-9)
    np.testing.assert_allclose(raw.root_quat_wxyz, MOTION.root_quat_wxyz, atol=1e-9)
    np.testing.assert_allclose(raw.q, MOTION.q, atol=1e-9)


def test_another_rate_is_an_option(tmp_path: Path) -> None:
    assert csv_file.load(write_csv(tmp_path / "walk.csv", MOTION), fps=120.0).fps == 120.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "empty"),
        ("\n \n", "no frames"),
        ("x,y,z\n1,2,3\n", "'x'"),
        ("1,2,3\n1,2,3\n", "3 columns"),
        (",".join(["0"] * 36) + "\n" + ",".join(["0"] * 20) + "\n", "row 2"),
        (",".join(["0"] * 36) + "\n", "at least 2"),
        ("\x00\xff", "no text"),
    ],
)
def test_what_is_no_motion_is_refused_in_one_line(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(BadFile) as refused:
        csv_file.load(path)
    assert expected in str(refused.value)
    assert "bad.csv" in str(refused.value)
    assert "\n" not in str(refused.value)
