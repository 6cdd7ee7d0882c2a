"""``station report`` and the rules of ``station check`` as a user types them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.running import Home, one_line
from tests.episode.synthetic import EpisodeBuilder, walk


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    builder = EpisodeBuilder(tmp_path / "data")
    walk(builder, seconds=1.0, rate_hz=30.0)
    return builder.finish()


def test_a_data_folder_becomes_a_page(home: Home, folder: Path, tmp_path: Path) -> None:
    done = home.run("report", "--data", str(tmp_path / "data"), "--out", str(tmp_path / "r.html"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"saved {tmp_path / 'r.html'}: 1 episode, ")
    page = (tmp_path / "r.html").read_text()
    assert folder.name in page
    assert "slow" in page


def test_what_is_asked_wrongly_is_told_in_a_line(home: Home, folder: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "r.html")
    assert "ends in .html" in one_line(home.run("report", str(folder), "--out", str(tmp_path / "r.txt")))
    assert "no episodes" in one_line(home.run("report", "--data", str(tmp_path / "none"), "--out", out))
    bad = tmp_path / "rules.yaml"
    bad.write_text("gapp: off")
    assert "unknown key 'gapp'" in one_line(home.run("check", str(folder), "--rules", str(bad)))
    assert "unknown key 'gapp'" in one_line(home.run("report", str(folder), "--rules", str(bad), "--out", out))
    assert not Path(out).exists()


def test_rules_are_printed_changed_and_obeyed(home: Home, folder: Path, tmp_path: Path) -> None:
    printed = home.run("check", "--print-rules").stdout
    rules = tmp_path / "rules.yaml"
    rules.write_text(printed.replace("below_share: 0.95 ", "below_share: 0.5  "))
    assert home.json("check", str(folder), "--no-write")["verdict"] == "usable"
    found = home.json("check", str(folder), "--rules", str(rules))
    assert (found["verdict"], [one["file"] for one in found["rules"]]) == ("good", ["shipped", str(rules)])
    (row,) = home.json("episodes", "list", "--data", str(tmp_path / "data"), "--min-quality", "good")
    assert row["episode_id"] == folder.name
