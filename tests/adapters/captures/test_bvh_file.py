"""The format BVH: what numbers of a file mean, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.captures import bvh_file
from station.errors import BadFile

TREE = """HIERARCHY
ROOT Hips
{{
  OFFSET 5 6 7
  CHANNELS 6 Xposition Yposition Zposition {first}
  JOINT Arm
  {{
    OFFSET 1 0 0
    CHANNELS 3 {second}
    End Site
    {{
      OFFSET 0 0 2
    }}
  }}
}}
MOTION
Frames: 1
Frame Time: 0.01
{values}
"""


def written(path: Path, values: str, first: str = "Zrotation Xrotation Yrotation", second: str = "") -> Path:
    path.write_text(TREE.format(first=first, second=second or first, values=values))
    return path


def test_the_first_channel_turns_last_and_angles_are_degrees(tmp_path: Path) -> None:
    """A quarter about z, then one about x, as they are listed: the child along x goes to y, the end along z to x."""
    path = written(tmp_path / "a.bvh", "1 2 3  90 90 0  0 0 0")
    places, _ = bvh_file.load(path).poses()
    np.testing.assert_allclose(places[:, 0], [[1, 2, 3], [1, 3, 3], [3, 3, 3]], atol=1e-12)


def test_channels_come_in_any_order_and_number(tmp_path: Path) -> None:
    path = written(tmp_path / "a.bvh", "1 2 3  90 0 90  30 0 0", first="Xrotation Yrotation Zrotation")
    places, turns = bvh_file.load(path).poses()
    np.testing.assert_allclose(places[1, 0], [1, 2, 4], atol=1e-12)  # x goes to y by z, and from there to z by x
    np.testing.assert_allclose(turns[0, 0] @ [0, 0, 1], [0, -1, 0], atol=1e-12)


def test_positions_of_a_joint_take_the_place_of_its_offset(tmp_path: Path) -> None:
    text = TREE.format(first="Zrotation Xrotation Yrotation", second="Xrotation", values="0 0 0 0 0 0 4 5 6 0")
    path = tmp_path / "a.bvh"
    path.write_text(text.replace("CHANNELS 3 Xrotation", "CHANNELS 4 Xposition Yposition Zposition Xrotation"))
    places, _ = bvh_file.load(path).poses()
    np.testing.assert_allclose(places[1, 0], [4, 5, 6])


def test_at_rest_all_rotations_are_zero(tmp_path: Path) -> None:
    places, turns = bvh_file.load(written(tmp_path / "a.bvh", "1 2 3 10 20 30 40 50 60")).rest()
    np.testing.assert_allclose(places[:, 0], [[5, 6, 7], [6, 6, 7], [6, 6, 9]])
    np.testing.assert_allclose(turns, np.broadcast_to(np.eye(3), turns.shape))


NINE = "0 0 0 0 0 0 0 0 0"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda text: "", "the file is empty"),
        (lambda text: "\x89PNG", "byte 0 is no text; expected a BVH file"),
        (lambda text: "; a script", "no BVH file: expected HIERARCHY and MOTION, came '; a script'"),
        (lambda text: text.replace("Frames: 1", "Frames: 2"), "9 numbers of motion; 2 frames of 9 channels have 18"),
        (lambda text: text.replace("Frames: 1", "Frames: 9999999"), "9999999 frames"),
        (lambda text: text.replace("0.01", "0"), "each longer than 0 s"),
        (lambda text: text.replace("Frame Time:", "Time:"), "expected Frames: and Frame Time:"),
        (lambda text: text.replace(NINE, "a " + NINE[2:]), "expected numbers of motion"),
        (lambda text: text.replace(NINE, "nan " + NINE[2:]), "a channel of frame 0 is not finite"),
        (lambda text: text.replace("Xposition ", ""), "channels of Hips: expected different ones of"),
        (lambda text: text.replace("6 Xposition", "5"), "Hips has 2 position channels; expected none or all three"),
        (lambda text: text.replace("CHANNELS 3", "CHANNELS 1e9"), "Arm has 1e+09 channels; expected 0 to 6"),
        (lambda text: text.replace("OFFSET 1 0 0", "OFFSET 1 0 x"), "'x' where a number is expected"),
        (lambda text: text.replace("}\nMOTION", "MOTION"), "the hierarchy is not closed"),
        (lambda text: text.replace("MOTION", "}\nMOTION"), "a bracket closes that none opened"),
        (lambda text: text.replace("JOINT Arm", "ROOT Arm"), "ROOT in a wrong place"),
        (lambda text: text.replace("JOINT Arm", "LIMB Arm"), "'LIMB' in the hierarchy"),
    ],
)  # fmt: skip
def test_a_file_that_is_none_is_told_in_one_line(tmp_path: Path, change, told: str) -> None:
    path = written(tmp_path / "a.bvh", NINE)
    path.write_bytes(change(path.read_text()).encode("latin-1"))
    with pytest.raises(BadFile) as caught:
        bvh_file.load(path)
    assert told in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_tree_that_nests_without_end_ends_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "deep.bvh"
    path.write_text("HIERARCHY ROOT a { OFFSET 0 0 0 " + "JOINT b { " * 100_000 + "MOTION")
    with pytest.raises(BadFile, match="more than 500 joints"):
        bvh_file.load(path)
