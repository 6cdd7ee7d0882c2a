"""``station init`` makes a folder in which the commands that it names work; ``station docs`` says how to go on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.cli.conftest import Wave
from tests.cli.running import Home, one_line
from tests.tiers import ROOT


def test_a_folder_holds_a_runbook_rules_and_a_place_for_episodes(home: Home, tmp_path: Path) -> None:
    lab = tmp_path / "new" / "lab"
    done = home.run("init", str(lab))
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in lab.iterdir()) == ["data", "g1-demo.yaml", "quality.yaml"]
    planned = subprocess.run(
        [sys.executable, "-m", "station", "up", "./g1-demo.yaml", "--dry-run"], cwd=lab, env=home.environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert planned.returncode == 0, planned.stderr
    assert "is there already" in one_line(home.run("init", str(lab)))
    assert home.run("init", str(lab), "commands-only").returncode == 2, "its rules would be written over"


def test_its_rules_are_those_that_ship(wave: Wave, tmp_path: Path) -> None:
    assert wave.home.run("init", str(tmp_path / "lab"), "commands-only").returncode == 0
    rules = tmp_path / "lab" / "quality.yaml"
    own = wave.home.run("check", str(wave.episode), "--no-write", "--rules", str(rules)).stdout
    assert own.splitlines()[0] == wave.home.run("check", str(wave.episode), "--no-write").stdout.splitlines()[0]


def test_what_cannot_be_made_is_said(home: Home, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    assert "is a file" in one_line(home.run("init", str(tmp_path / "file")))
    assert "cannot be written" in one_line(home.run("init", str(tmp_path / "file" / "lab")))
    assert "unknown runbook 'g1-dmo' (did you mean 'g1-demo'?)" in one_line(
        home.run("init", str(tmp_path / "lab"), "g1-dmo")
    )
    assert not (tmp_path / "lab").exists()


def test_the_docs_are_read_in_a_terminal(home: Home) -> None:
    listed = home.run("docs").stdout
    pages = sorted(path.stem for path in (ROOT / "docs").glob("*.md") if path.stem != "index")
    assert [line.split()[0] for line in listed.splitlines()[1 : len(pages) + 1]] == pages
    text = (ROOT / "docs" / "motions.md").read_text(encoding="utf-8")
    assert home.run("docs", "motions").stdout == home.run("docs", "docs/motions.md").stdout == text
    assert "(did you mean 'motions'?)" in one_line(home.run("docs", "motons"))
