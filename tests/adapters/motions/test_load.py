from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from adapters.motions.load import load
from station.errors import AssetMissing, BadFile, UsageError
from tests.adapters.motions.made import content, smooth, spoiled, write_csv, write_pkl

MOTION = smooth()
SIX = [f"twist2:motions/0807_yanjie_walk_{number:03}.pkl" for number in range(1, 7)]


def test_the_suffix_chooses_the_reader_and_all_readers_agree(tmp_path: Path) -> None:
    pkl = load(write_pkl(tmp_path / "walk.pkl", content(MOTION)))
    csv = load(str(write_csv(tmp_path / "walk.CSV", MOTION)))
    assert (pkl.facts()["format"], csv.facts()["format"]) == ("pkl", "csv")
    np.testing.assert_allclose(pkl.at(1.0).q, csv.at(1.0).q, atol=1e-9)


def test_facts_tell_the_file_its_hash_and_what_was_done(tmp_path: Path) -> None:
    path = write_pkl(tmp_path / "walk.pkl", content(spoiled(MOTION, root_pos={0: [0, 0, 9.0], 40: [0, 0, 9.0]})))
    facts = load(path, holes="bridge").facts()
    assert facts["file"] == str(path)
    assert facts["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (facts["first_frame"], facts["last_frame"], facts["fps"]) == (1, 89, 30.0)
    assert facts["trimmed"] == {"start": 1, "end": 0}
    assert facts["bridged"] == [[40, 40]]
    assert facts["duration_s"] == pytest.approx(88 / 30)


def test_a_reference_may_end_in_what_is_done_to_the_motion(tmp_path: Path) -> None:
    path = write_pkl(tmp_path / "walk.pkl", content(MOTION))
    plain, seen, fast = (load(f"{path}{changes}") for changes in ("", "#mirror", "#mirror#speed=2"))
    assert (seen.name, fast.name) == ("walk#mirror", "walk#mirror#speed=2")
    assert fast.duration_s == pytest.approx(plain.duration_s / 2)
    left, right = (plain.joint_names.index(f"{side}_elbow") for side in ("left", "right"))
    assert seen.at(1.0).q[left] == fast.at(0.5).q[left] == plain.at(1.0).q[right]
    assert fast.facts()["file"] == str(path), "the hash is that of this file"
    assert fast.facts()["mirrored"] is True
    assert fast.facts()["speed"] == 2.0


def test_any_other_hash_sign_belongs_to_the_name_of_a_file(tmp_path: Path) -> None:
    assert load(write_pkl(tmp_path / "take#2.pkl", content(MOTION))).name == "take#2"
    assert load(f"{write_pkl(tmp_path / 'take#mirror.pkl', content(MOTION))}#speed=1.5").name == "take#mirror#speed=1.5"
    with pytest.raises(BadFile, match=r"walk\.pkl#mirrored: no such file"):
        load(tmp_path / "walk.pkl#mirrored")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("speed=fast", "speed is 'fast'; expected a number, for example 1.2"),
        ("speed=", "speed is ''; expected a number"),
        ("speed=0", "speed is 0.0; expected a number from 0.1 to 10"),
        ("speed=nan", "speed is nan"),
    ],
)
def test_a_speed_that_cannot_be_is_refused(change: str, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        load(f"builtin:wave#{change}")


def test_an_unknown_suffix_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text("HIERARCHY")
    with pytest.raises(BadFile, match=r"'\.bvh'; known: \.csv, \.npz, \.onnx, \.pkl"):
        load(tmp_path / "walk.bvh")


def test_a_missing_file_suggests_its_neighbour(tmp_path: Path) -> None:
    write_pkl(tmp_path / "walk_001.pkl", {})
    with pytest.raises(BadFile, match=r"did you mean 'walk_001\.pkl'"):
        load(tmp_path / "walk_010.pkl")


def test_upstream_data_that_is_not_there_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATION_ASSETS", raising=False)
    with pytest.raises(AssetMissing, match="STATION_ASSETS"):
        load(SIX[0])


@pytest.mark.assets
@pytest.mark.parametrize(
    ("reference", "frames", "trimmed"),
    list(zip(SIX, [416, 399, 490, 380, 516, 449], [1, 0, 0, 2, 1, 0], strict=True)),
)
def test_the_six_example_motions_load_with_their_bad_starts_trimmed(
    assets: Path, reference: str, frames: int, trimmed: int
) -> None:
    clip = load(reference)
    facts = clip.facts()
    assert facts["file"] == reference
    assert facts["frames_in_file"] == frames
    assert facts["trimmed"] == {"start": trimmed, "end": 0}
    assert facts["bridged"] == []
    assert 29.7 < clip.fps < 29.9
    speeds = [np.linalg.norm(clip.at(time_s).root_lin_vel) for time_s in np.arange(0, clip.duration_s, 0.02)]
    assert max(speeds) < 1.7


@pytest.mark.assets
def test_the_fourth_motion_starts_a_metre_too_high_and_says_so(assets: Path) -> None:
    found = load(SIX[3]).facts()["bad_frames"]
    assert "frames 0->1: root climb 30.93 m/s (limit 4.5)" in found
    assert "frames 1->2: speed of left_elbow 35.46 rad/s (limit 30)" in found
