"""``station motions``: what can be played, and whether a file can."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.motions import builtin, velocities
from adapters.robots.g1.joints import G1_29
from tests.cli.running import Home

pytestmark = pytest.mark.usefixtures("processes")

FRAMES, FPS = 100, 50.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A good motion without wrists, one with a jump in its middle, and one that is none."""
    names = [name for name in G1_29 if "wrist" not in name]
    root = np.tile([0.0, 0.0, 0.78], (FRAMES, 1))
    values = {
        "fps": FPS, "root_pos": root, "root_quat_wxyz": np.tile([1.0, 0, 0, 0], (FRAMES, 1)),
        "joint_pos": np.zeros((FRAMES, len(names))), "joint_names": names,
    }  # fmt: skip
    np.savez(tmp_path / "good.npz", **values)
    jump = root.copy()
    jump[50:53, 2] += 1.0
    np.savez(tmp_path / "jump.npz", **(values | {"root_pos": jump}))
    (tmp_path / "none.csv").write_text("a,b\n")
    return tmp_path


def test_built_in_motions_are_listed_with_their_lengths(home: Home) -> None:
    found = {row["motion"]: row for row in home.without("STATION_ASSETS").json("motions")}
    scripts = {f"velocity:{name}" for name in velocities.names()}
    assert set(found) == {f"builtin:{name}" for name in builtin.names()} | scripts
    assert found["velocity:figure-eight"]["seconds"] == pytest.approx(4.0 + 4.0 * 3.1416 * 2.0, abs=0.01)
    assert found["builtin:tour"]["seconds"] > 50.0
    assert "station motions --formats" in home.without("STATION_ASSETS").run("motions").stdout


def test_files_are_read_as_the_motion_server_does_and_what_is_wrong_is_told(home: Home, folder: Path) -> None:
    done = home.run("motions", str(folder / "*.*"), "builtin:bow#speed=2")
    assert done.returncode == 1
    table, notes = done.stdout.splitlines()[1:3], "\n".join(done.stdout.splitlines()[3:])
    assert [line.split()[0] for line in table] == [str(folder / "good.npz"), "builtin:bow#speed=2"]
    assert table[0].split()[1:] == ["npz", "2.0", "s", "50", "Hz", "100"]
    assert table[1].split()[2:4] == ["2.3", "s"]
    assert f"{folder / 'good.npz'}: not in the file, held at 0: left_wrist_roll, left_wrist_pitch" in notes
    assert f"{folder / 'jump.npz'}: " in notes
    assert f"{folder / 'none.csv'}: " in notes
    bridged = home.json("motions", str(folder / "jump.npz"), "--holes", "bridge")
    assert [(row["problem"], "1 hole bridged" in row["note"]) for row in bridged] == [("", True)]


def test_of_what_cannot_be_played_there_is_no_row(home: Home) -> None:
    done = home.run("motions", "nowhere.npz")
    assert (done.returncode, len(done.stdout.splitlines())) == (1, 1)
    assert "nowhere.npz" in done.stdout


def test_what_each_format_holds_is_told(home: Home) -> None:
    said = home.json("motions", "--formats")
    assert set(said) == {".csv", ".npz", ".onnx", ".pkl", ".velocity"}
    assert "root_quat_wxyz" in said[".npz"]
    assert "root_quat_wxyz" in home.run("motions", "--formats").stdout
