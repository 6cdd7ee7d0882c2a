"""``station enrich`` in a terminal: what it says, and what is left when it is stopped, killed or out of disk."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from station.enrich.source import ENRICHED
from station.episode.storage.records import walk as walk_records
from tests.cli.at_terminal import AtTerminal
from tests.cli.running import Home, one_line
from tests.enrich.read_back import topics
from tests.enrich.recordings import walked
from tests.episode.synthetic import EpisodeBuilder, walk
from tests.main_job.station_runs import ROOT
from tests.waiting import wait_until

PART = f".{ENRICHED}.part"


HALF_WAY = """
import runpy, time
from station.enrich import enrich as enriching
fill = enriching._Output.fill
def fill_half(self, reader, survey, progress):
    def tell(done, of):
        progress(done, of)
        while 0 < done < of:
            time.sleep(0.1)
    fill(self, reader, survey, tell)
enriching._Output.fill = fill_half
runpy.run_module("station", run_name="__main__", alter_sys=True)
"""
"""The station, which goes no further once it has told how far it is."""


@pytest.fixture(scope="module")
def long_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that takes so long that it is told how far it is."""
    return walked(tmp_path_factory.mktemp("long"), seconds=40.0)


def test_it_says_what_it_made_and_what_it_left_out_and_then_that_nothing_is_to_do(home: Home) -> None:
    folder = walked(home.data)
    first = home.run("episodes", "enrich", "latest")
    assert first.returncode == 0, first.stderr
    assert f"{folder.name} {len(topics(folder / ENRICHED))} typed topics" in first.stdout
    assert "not typed, its contract names no elements: operator_joints_gello, policy_action_" in first.stdout
    assert home.run("enrich", str(folder)).stdout == f"{folder.name} up to date: {folder / ENRICHED}\n"
    (told,) = home.json("enrich", "latest", "--force")
    assert (told["state"], told["path"]) == ("written", str(folder / ENRICHED))


def test_all_takes_finished_episodes_and_tells_of_the_others(home: Home) -> None:
    good = walked(home.data, number=1)
    discarded = EpisodeBuilder(home.data, number=2)
    walk(discarded, seconds=0.1)
    discarded.finish({"quality_flags": {"discarded": True}})
    unfinished = EpisodeBuilder(home.data, number=3)
    walk(unfinished, seconds=0.1)
    torn = unfinished.finish({"state": "recording"}, torn=True)
    done = home.run("enrich", "--all")
    assert done.returncode == 0
    assert done.stderr == f"station: {torn.name}: left out, it is unfinished\n"
    assert [path.parent for path in home.data.rglob(ENRICHED)] == [good]


def test_a_bad_episode_is_told_of_in_a_line_and_the_others_are_enriched(home: Home) -> None:
    good, bad = walked(home.data, number=1), walked(home.data, number=2)
    signals = bad / "signals.mcap"
    first = walk_records(signals).chunks[0]
    middle = first.offset + first.length // 2
    with signals.open("r+b") as file:
        file.seek(middle)
        file.write(bytes(64))
    done = home.run("enrich", str(bad), str(good))
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert str(signals) in done.stderr
    assert "damaged" in done.stderr
    assert (good / ENRICHED).exists()
    assert not list(bad.glob("*enriched*"))
    assert not (bad / PART).exists()


def test_neither_episodes_nor_all_is_a_mistake_of_one_line(home: Home) -> None:
    assert "name the EPISODEs to enrich, or give --all" in one_line(home.run("enrich"))
    assert "name the EPISODEs to enrich, or give --all" in one_line(home.run("enrich", "latest", "--all"))


def test_on_a_terminal_a_bar_moves_and_ctrl_c_leaves_nothing(home: Home, long_walk: Path) -> None:
    (long_walk / ENRICHED).unlink(missing_ok=True)
    with AtTerminal(home, "enrich", str(long_walk), program=("-c", HALF_WAY)) as terminal:
        wait_until(lambda: long_walk.name in terminal.screen and (long_walk / PART).exists())
        terminal.type(b"\x03")
        assert terminal.finish() == 130
    assert "interrupted" in terminal.screen
    assert not (long_walk / PART).exists()
    assert not (long_walk / ENRICHED).exists()


def test_a_killed_one_leaves_no_half_file_and_the_next_one_makes_a_whole_one(home: Home, long_walk: Path) -> None:
    (long_walk / ENRICHED).unlink(missing_ok=True)
    command = [sys.executable, "-c", HALF_WAY, "enrich", str(long_walk)]
    with subprocess.Popen(command, cwd=ROOT, env=home.environment, stderr=subprocess.DEVNULL) as process:
        wait_until((long_walk / PART).exists)
        process.send_signal(signal.SIGKILL)
    assert not (long_walk / ENRICHED).exists()
    assert home.run("enrich", str(long_walk)).returncode == 0
    assert topics(long_walk / ENRICHED)
    assert not (long_walk / PART).exists()


def test_two_at_once_do_not_write_the_same_file(home: Home) -> None:
    folder = walked(home.data)
    holder = os.open(folder / PART, os.O_WRONLY | os.O_CREAT)
    fcntl.flock(holder, fcntl.LOCK_EX)
    try:
        assert "another process is writing this file" in one_line(home.run("enrich", "latest"))
    finally:
        os.close(holder)
    assert home.run("enrich", "latest").returncode == 0


def test_a_full_disk_leaves_the_old_file_and_is_told_of_in_a_line(home: Home) -> None:
    folder = walked(home.data, seconds=4.0)
    assert home.run("enrich", "latest").returncode == 0
    before = (folder / ENRICHED).read_bytes()
    limited = f"ulimit -f 8; exec {sys.executable} -m station enrich latest --force"  # blocks of 512 or 1024 bytes
    done = subprocess.run(
        ["sh", "-c", limited], cwd=ROOT, env=home.environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert f"{folder / ENRICHED}: cannot be written: File too large" in one_line(done)
    assert (folder / ENRICHED).read_bytes() == before
    assert not (folder / PART).exists()


def test_an_enriched_episode_is_listed_checked_and_shown_as_before(home: Home) -> None:
    folder = walked(home.data)
    before = home.json("check", str(folder), "--no-write"), home.json("episodes", "show", str(folder))
    assert home.run("enrich", "latest").returncode == 0
    assert (home.json("check", str(folder), "--no-write"), home.json("episodes", "show", str(folder))) == before
    saved = home.run("view", "latest", "--save", str(home.data / "view.rrd"))
    assert saved.returncode == 0, saved.stderr
    assert json.dumps([row["episode_id"] for row in home.json("episodes", "list")]) == json.dumps([folder.name])
