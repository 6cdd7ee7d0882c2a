"""``station retarget``: many captures, some of them bad, to motions; twice, by force, and interrupted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from adapters.retarget.skeleton_file import Skeletons
from tests.adapters.captures.people import moving
from tests.adapters.captures.written import write_amass, write_bvh, write_c3d
from tests.cli.running import Home, are_gone
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")
pytest.importorskip("mink")

TO_G1 = ("--to", "unitree_g1")


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    """A folder of two good captures, one of them in a folder inside, and two bad ones."""
    folder = tmp_path / "captures"
    (folder / "inside").mkdir(parents=True)
    write_bvh(folder / "wave.bvh", moving("wave", 1.0))
    write_amass(folder / "inside" / "walk_poses.npz", moving("walk-forward", 1.0))
    (folder / "torn.bvh").write_text("HIERARCHY ROOT a {")
    (folder / "marks.c3d").write_bytes(b"no C3D")
    return folder


def test_bad_files_do_not_stop_the_others_and_what_was_made_can_be_played(home: Home, captures: Path) -> None:
    out = captures.parent / "motions"
    done = home.run("retarget", str(captures), *TO_G1, "--out", str(out), "--jobs", "2")
    assert done.returncode == 1
    assert sorted(path.relative_to(out).as_posix() for path in out.rglob("*.npz")) == [
        "inside/walk_poses.npz",
        "wave.npz",
    ]
    told = done.stderr.splitlines()
    assert [line.split()[0] for line in told] == ["failed:", "failed:"]
    assert "marks.c3d" in told[0]
    assert "torn.bvh: no BVH file" in told[1]
    rows = [line for line in done.stdout.splitlines() if "90 to 50 Hz" in line]
    assert [row.split()[-1] for row in rows] == ["yes", "yes"]
    assert "lengths taken for cm: the person is 1.72 m tall" in done.stdout
    assert "station rehearse" in done.stdout.splitlines()[-1]
    assert home.run("motions", str(out / "*.npz")).returncode == 0
    again = home.run("retarget", str(captures / "wave.bvh"), *TO_G1, "--out", str(out))
    assert (again.returncode, again.stdout.splitlines()) == (
        0,
        ["1 there already, made of the same files in the same way"],
    )


def test_the_tracker_walks_what_markers_say(home: Home, tmp_path: Path) -> None:
    pytest.importorskip("c3d")
    write_c3d(tmp_path / "markers.c3d", walker())
    assert_walked(home, tmp_path, 1)


def walker() -> Skeletons:
    """A person who stands, walks forward and stands again."""
    return moving("walk-forward", 9.0, 0.0)


def assert_walked(home: Home, folder: Path, count: int) -> None:
    """Retarget all files of a folder; in simulation the tracker follows each motion without a fall."""
    out = folder / "motions"
    assert home.run("retarget", str(folder), *TO_G1, "--out", str(out), "--height", "1.72").returncode == 0
    done = home.run("rehearse", str(out / "*.npz"), "--json")
    assert done.returncode == 0
    results = json.loads(done.stdout)["motions"]
    assert [result["fell"] for result in results] == [False] * count
    assert max(result["mean_joint_error_rad"] for result in results) < 0.08


def test_for_programs_it_is_json(home: Home, captures: Path) -> None:
    out = captures.parent / "motions"
    said = home.json("retarget", str(captures), *TO_G1, "--out", str(out), "--fps", "30", "--height", "1.6")
    assert {Path(each["source"]).name for each in said["failed"]} == {"marks.c3d", "torn.bvh"}
    by_name = {Path(each["source"]).name: each for each in said["motions"]}
    wave = by_name["wave.bvh"]
    assert (wave["fps"], wave["frames"], wave["height_m"], wave["why_not"]) == (30.0, 30, 1.6, "")
    assert set(wave) >= {"at_limit_s", "slowed_s", "slide_mps", "unit", "notes", "target", "is_kept"}
    assert by_name["walk_poses.npz"]["target"] == str(out / "inside" / "walk_poses.npz")


def test_a_motion_of_the_users_is_not_replaced(home: Home, captures: Path) -> None:
    out = captures.parent / "motions"
    out.mkdir()
    (out / "wave.npz").write_text("precious")
    asked = ("retarget", str(captures / "wave.bvh"), *TO_G1, "--out", str(out))
    done = home.run(*asked)
    assert (done.returncode, (out / "wave.npz").read_text()) == (1, "precious")
    assert "--force replaces it" in done.stderr
    assert home.run(*asked, "--force").returncode == 0
    assert home.run("motions", str(out / "wave.npz")).returncode == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ["{}/wave.bvh", "--to", "unitree_h1"],
            "unknown robot to retarget to 'unitree_h1' (did you mean 'unitree_g1'?)",
        ),
        (["{}/nothing.bvh", *TO_G1], "nothing.bvh: no such file; name captures, or a folder of them"),
        (
            ["{}/inside/walk_poses.npz", *TO_G1, "--out", "{}/inside"],
            "walk_poses.npz is itself a capture that is named",
        ),
        (["{}/wave.bvh", "{}/inside/../torn.bvh", *TO_G1, "--height", "17"], "17.0 is not in the range 1.2<=x<=2.2"),
        (["{}/wave.bvh", "{}/other/wave.bvh", *TO_G1], "would both be"),
        (["{}/empty", *TO_G1], "empty: holds no captures; expected files that end in .bvh, .c3d, .npz"),
    ],
)
def test_what_cannot_be_is_told_before_anything_is_done(
    home: Home, captures: Path, words: list[str], told: str
) -> None:
    (captures / "empty").mkdir()
    (captures / "other").mkdir()
    (captures / "other" / "wave.bvh").write_text("")
    out = captures.parent / "motions"
    given = [word.format(captures) for word in words]
    done = home.run("retarget", *given, *(() if "--out" in words else ("--out", str(out))))
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert told in done.stderr
    assert not out.exists()


def test_an_interrupt_ends_the_children_keeps_what_is_made_and_the_same_command_goes_on(
    home: Home, tmp_path: Path
) -> None:
    person, out = moving("walk-forward", 3.0), tmp_path / "motions"
    names = [f"{number}.bvh" for number in range(4)]
    write_bvh(tmp_path / names[0], moving("wave", 0.5))
    first = write_bvh(tmp_path / names[1], person)
    for name in names[2:]:
        (tmp_path / name).write_bytes(first.read_bytes())
    asked = ("retarget", *(str(tmp_path / name) for name in names), *TO_G1, "--out", str(out), "--jobs", "2")
    with home.running(*asked) as running:
        running.wait_until((out / "0.npz").is_file)
        children = Path(f"/proc/{running.process.pid}/task/{running.process.pid}/children").read_text().split()
        running.interrupt()
        code, printed = running.finish()
    assert (code, printed) == (130, "")
    assert running.lines[-1].startswith("station: interrupted; ")
    assert running.lines[-1].endswith(" of 4 motions are made and kept; the same command goes on from there")
    wait_until(lambda: are_gone([int(pid) for pid in children]))
    left = {path.name: path.stat().st_mtime_ns for path in out.iterdir() if path.suffix == ".npz"}
    assert "0.npz" in left
    said = json.loads(home.run(*asked, "--json").stdout)
    assert [each["is_kept"] for each in said["motions"]].count(True) == len(left)
    assert len(said["motions"]) == 4
    assert {path.name: path.stat().st_mtime_ns for path in out.iterdir()}["0.npz"] == left["0.npz"]
