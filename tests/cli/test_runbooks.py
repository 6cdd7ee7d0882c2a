"""``station runbooks``: what can be run, and a file of one's own to begin with."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.supervision import runbook
from tests.cli.running import Home, one_line

pytestmark = pytest.mark.usefixtures("processes")


def test_all_that_ship_are_listed_with_what_they_are_for(home: Home) -> None:
    listed = home.json("runbooks", "list")
    assert [row["name"] for row in listed] == list(runbook.shipped())
    said = home.run("runbooks", "list").stdout
    assert all(row["name"] in said and row["about"] in said for row in listed)


def test_a_copy_is_shown_runs_and_is_never_written_over(home: Home, tmp_path: Path) -> None:
    shipped = runbook.shipped()["g1-demo"].read_text()
    assert home.run("runbooks", "show", "g1-demo").stdout == shipped
    mine = tmp_path / "mine.yaml"
    assert f"station up {mine}" in home.run("runbooks", "copy", "g1-demo", str(mine)).stdout
    assert mine.read_text() == shipped
    mine.write_text(shipped.replace("g1-demo\n", "my-demo\n"))
    assert home.run("up", str(mine), "--dry-run").stdout.startswith("my-demo · ")
    assert "is there already, and is left as it is" in one_line(home.run("runbooks", "copy", "g1-demo", str(mine)))
    assert home.run("runbooks", "copy", "g1-demo", str(tmp_path)).returncode == 0
    assert (tmp_path / "g1-demo.yaml").read_text() == shipped
    assert "cannot be written" in one_line(home.run("runbooks", "copy", "g1-demo", str(mine / "below.yaml")))


def test_what_is_no_runbook_is_told(home: Home, tmp_path: Path) -> None:
    assert "did you mean 'g1-demo'?" in one_line(home.run("runbooks", "show", "g1-dem"))
    other = tmp_path / "other.yaml"
    other.write_text("a: 1\n")
    assert f"{other}: unknown key 'a'" in one_line(home.run("runbooks", "show", str(other)))


def test_a_robot_that_its_servers_do_not_drive_ends_it_before_anything_moves(home: Home, tmp_path: Path) -> None:
    odd = tmp_path / "odd.yaml"
    text = runbook.shipped()["g1-sim-motion"].read_text()
    odd.write_text(text.replace("robot: unitree_g1_with_hands", "robot: unitree_h1"))
    done = home.run("up", str(odd), "--yes")
    assert done.returncode == 1
    assert "robot: expected what its servers drive, unitree_g1_with_hands, got 'unitree_h1'" in done.stderr
    assert "✓ start g1" not in done.stderr
