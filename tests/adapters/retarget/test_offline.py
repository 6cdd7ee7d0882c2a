"""Captures as motion files of the G1: what is written, what is told, and that three formats say the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.motions import npz_file
from adapters.motions.load import load
from adapters.retarget.offline import resampled, retarget
from adapters.retarget.skeleton_file import Skeletons
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.errors import BadFile
from station.retargeting import RetargetTask
from tests.adapters.captures.people import moving
from tests.adapters.captures.written import write_amass, write_bvh, write_c3d

pytest.importorskip("mink")

SAME_RAD, SAME_BY_MARKERS_RAD = 0.01, 0.05
"""How near the joints of the robot come to each other, the mean: of BVH and AMASS, and of markers beside the joints."""


def task(source: Path, **changes: Any) -> RetargetTask:
    said: dict[str, Any] = {"robot": "unitree_g1", "fps": 50.0, "height_m": 1.72} | changes
    return RetargetTask(source=source, target=source.parent / "out" / f"{source.stem}.npz", **said)


def test_three_formats_of_one_person_make_the_same_motion(tmp_path: Path) -> None:
    pytest.importorskip("c3d")
    person = moving("walk-forward", 0.8)
    sources = [
        write_bvh(tmp_path / "by_bvh.bvh", person), write_amass(tmp_path / "by_amass.npz", person),
        write_c3d(tmp_path / "by_markers.c3d", person),
    ]  # fmt: skip
    done = [retarget(task(source)) for source in sources]
    of_bvh, of_amass, of_markers = (npz_file.load(Path(each.target)) for each in done)
    assert of_bvh.fps == 50.0
    assert np.abs(of_bvh.q - of_amass.q).mean() < SAME_RAD
    assert np.abs(of_bvh.q - of_markers.q).mean() < SAME_BY_MARKERS_RAD
    for other in (of_amass, of_markers):
        assert np.linalg.norm(of_bvh.root_pos - other.root_pos, axis=1).max() < 0.03
    assert [each.why_not for each in done] == [""] * 3
    assert max(each.slide_mps for each in done) < 0.02


def test_the_robot_does_what_the_person_imitated(tmp_path: Path) -> None:
    """The person does a clip of the G1: what comes back is the clip, in its joints, its height and its way."""
    person, clip = moving("walk-forward", 1.0), load("builtin:walk-forward")
    retarget(task(write_bvh(tmp_path / "walk.bvh", person)))
    came = load(tmp_path / "out" / "walk.npz")
    times = np.arange(0.3, 0.9, 0.05)
    q, height, speed = (
        np.array([read(came.at(t)) for t in times]) - np.array([read(clip.at(t + 1.0)) for t in times])
        for read in (lambda at: at.q, lambda at: at.root_pos[2], lambda at: at.root_lin_vel[0])
    )
    assert np.abs(q).mean() < 0.06
    assert np.abs(height).mean() < 0.02
    assert abs(speed.mean()) < 0.05


def test_a_file_says_where_it_is_from_and_so_does_the_manifest(tmp_path: Path) -> None:
    source = write_bvh(tmp_path / "wave.bvh", moving("wave", 1.0))
    done = retarget(task(source, fps=40.0))
    facts = load(done.target).facts()["provenance"]
    assert {name: facts[name] for name in ("name", "source", "robot", "fps", "height_m")} == {
        "name": "wave", "source": "wave.bvh", "robot": "unitree_g1", "fps": 40.0, "height_m": 1.72,
    }  # fmt: skip
    assert len(facts["source_sha256"]) == 64
    assert (done.frames, done.fps, done.captured_fps) == (40, 40.0, 90.0)
    assert (done.unit, done.height_m) == ("scaled to 1.72 m", 1.72)


def test_what_is_there_is_kept_if_it_is_the_same_and_replaced_by_force_alone(tmp_path: Path) -> None:
    source = write_bvh(tmp_path / "wave.bvh", moving("wave", 0.2))
    first = retarget(task(source))
    before = Path(first.target).read_bytes()
    assert retarget(task(source)).is_kept
    with pytest.raises(BadFile, match=r"wave\.npz: is there, and not what would be made of .*; --force replaces it"):
        retarget(task(source, height_m=1.6))
    assert Path(first.target).read_bytes() == before
    assert not retarget(task(source, height_m=1.6, force=True)).is_kept
    assert Path(first.target).read_bytes() != before
    Path(first.target).write_text("something else of the user's")
    with pytest.raises(BadFile, match="--force replaces it"):
        retarget(task(source))
    assert Path(first.target).read_text() == "something else of the user's"
    assert [path.name for path in Path(first.target).parent.iterdir()] == ["wave.npz"]


def test_limits_are_kept_and_what_reached_them_is_told(tmp_path: Path) -> None:
    """A person who walks eight times as fast: the robot lags behind, and no joint leaves its range."""
    person = moving("walk-forward", 1.5)
    fast = replace(person, times_s=person.times_s / 8.0)
    done = retarget(task(write_bvh(tmp_path / "fast.bvh", fast)))
    q = npz_file.load(Path(done.target)).q
    assert (q >= g1.lower(G1_29)).all()
    assert (q <= g1.upper(G1_29)).all()
    assert "root" in done.slowed_s
    assert 0.0 < done.slowed_s["root"] < done.seconds
    deep = retarget(task(write_bvh(tmp_path / "deep.bvh", moving("squat", 0.5, 2.0))))
    assert deep.slowed_s == {}
    assert all(0.0 < time_s <= deep.seconds + 0.02 for time_s in deep.at_limit_s.values())


def test_a_person_who_lies_down_is_no_motion_of_a_robot_that_stands(tmp_path: Path) -> None:
    person = moving("wave", 1.0)
    angle = np.linspace(0.0, -1.4, len(person))
    fall = rotations.from_rotation_vector(np.stack([0.0 * angle, angle, 0.0 * angle], axis=1))[:, None]
    lying = replace(
        person,
        positions=rotations.rotate(fall, person.positions),
        quats_wxyz=rotations.multiply(np.broadcast_to(fall, person.quats_wxyz.shape), person.quats_wxyz),
    )
    done = retarget(task(write_bvh(tmp_path / "lies.bvh", lying)))
    assert "the pelvis leans by 80° at 0.98 s; a robot that leans by more than 60° counts as fallen" in done.why_not
    assert (done.target, (tmp_path / "out").exists()) == ("", False)


def test_a_capture_at_uneven_times_is_sampled_evenly_and_turns_the_short_way() -> None:
    half = np.array([0.0, 0.0, 0.0, 1.0])
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (3, 24, 1))
    quats[1] = [np.cos(0.1), 0.0, 0.0, np.sin(0.1)]
    quats[2] = -quats[1]
    places = np.array([0.0, 1.0, 1.0])[:, None, None] * np.ones((3, 24, 3))
    found = resampled(Skeletons(places, quats, np.array([2.0, 2.1, 2.2])), 0.05)
    np.testing.assert_allclose(found.times_s, [2.0, 2.05, 2.1, 2.15, 2.2])
    np.testing.assert_allclose(found.positions[:, 0, 0], [0.0, 0.5, 1.0, 1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(np.abs(found.quats_wxyz[:, 0] @ half), np.sin([0.0, 0.05, 0.1, 0.1, 0.1]), atol=1e-9)


def test_a_capture_that_is_too_short_is_told(tmp_path: Path) -> None:
    person = moving("wave", 0.5)
    short = Skeletons(person.positions[:2], person.quats_wxyz[:2], np.array([0.0, 0.001]), person.height_m)
    with pytest.raises(BadFile, match=r"the capture lasts 0\.001 s; expected 0\.010 s at least"):
        retarget(task(write_bvh(tmp_path / "short.bvh", short)))
