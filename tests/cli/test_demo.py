"""``station demo`` as a newcomer runs it, without upstream data; and on a machine that cannot draw."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.replaying.audit import audit
from station.view import names
from tests.cli.at_terminal import at_a_terminal
from tests.cli.running import DEMO, IN_STEP, SHORT, Home, are_gone, demo_episode, new_home
from tests.verdicts import expect_no_worse_but_late
from tests.view.pictures import drawing_machine, pixels

__all__ = ["drawing_machine"]


@pytest.fixture(scope="module")
def bare(processes: None) -> Iterator[Home]:
    """A place without upstream data."""
    with new_home() as made:
        made.environment["PATH"] = f"{Path(sys.executable).parent}:{made.environment['PATH']}"
        yield made.without("STATION_ASSETS")


@pytest.fixture(scope="module")
def done(bare: Home) -> CompletedProcess[str]:
    """A demo that has run to its end; by the clock it runs in `test_proof_cli`."""
    return bare.run(*DEMO, *IN_STEP)


@pytest.fixture
def episode(bare: Home, done: CompletedProcess[str]) -> Path:
    return demo_episode(bare, done)


def test_without_upstream_data_the_robot_walks_is_recorded_checked_and_audited(
    done: CompletedProcess[str], episode: Path
) -> None:
    assert "0 lost, 0 falls" in done.stdout
    assert " steps, 0 different" in done.stdout
    reader = open_episode(episode)
    quality = check(reader)
    expect_no_worse_but_late("good", quality)
    assert f": {quality.verdict}   " in done.stdout, done.stdout
    assert reader.manifest.policy.name == "tracker"
    assert reader.manifest.robot.facts["model"].endswith("g1.xml")
    assert audit(reader).is_equal


def test_progress_is_told_in_plain_lines(done: CompletedProcess[str], episode: Path) -> None:
    assert "✓ start g1" in done.stderr
    assert "· tour: " in done.stderr
    assert "upright, leans " in done.stderr
    assert f"recorded {episode.name}" in done.stderr
    assert "\x1b" not in done.stderr + done.stdout


@pytest.mark.usefixtures("drawing_machine")
def test_pictures_lie_in_the_episode_and_are_named(done: CompletedProcess[str], episode: Path) -> None:
    for name in (names.CONTACT_SHEET, names.PLOT, names.RERUN):
        assert str(episode / name) in done.stdout
        assert (episode / name).stat().st_size > 50_000
    for name in (names.CONTACT_SHEET, names.PLOT):
        picture = pixels(episode / name)
        assert picture.shape[1] == 1600
        assert picture.std() > 10


@pytest.mark.usefixtures("drawing_machine")
def test_it_ends_with_one_screen_what_happened_three_things_to_open_and_two_to_try(
    done: CompletedProcess[str], episode: Path
) -> None:
    happened, opened, tried, last = (part.splitlines() for part in done.stdout.strip().split("\n\n"))
    assert happened[0].startswith(f"{episode.name}: ")
    assert any(line.startswith("  mean joint error ") for line in happened)
    assert happened[-1].startswith("  tracker, run again on what was recorded: ")
    assert opened[0] == "open:"
    assert len(opened) == 4
    assert tried == [
        "try:",
        "  station up g1-demo --yes --record --task mine   record a task of your own",
        "  station up g1-demo --yes --console              watch, stop and record in a browser: http://127.0.0.1:8770",
    ]
    assert last == ["all figures: station check latest   all curves: station view latest"]
    assert len(done.stdout.splitlines()) < 24


def test_pictures_of_an_episode_are_drawn_again_on_demand(bare: Home, episode: Path, tmp_path: Path) -> None:
    plot = tmp_path / "p.png"
    drawn = bare.run("view", str(episode), "--plot", str(plot))
    assert drawn.returncode == 0, drawn.stderr
    assert drawn.stdout == f"saved {plot}\n"
    assert pixels(plot).shape == pixels(episode / names.PLOT).shape


def test_a_machine_that_cannot_draw_and_a_shell_that_does_not_know_station_are_told(home: Home) -> None:
    """The shell is as after `make demo`: its environment was made, and not entered."""
    home.environment |= {"PATH": os.defpath, "MUJOCO_GL": "bogus"}
    done = home.without("STATION_ASSETS").run(*DEMO, *IN_STEP)
    assert done.returncode == 0, done.stderr
    assert "contact sheet skipped: this machine cannot render ($MUJOCO_GL is 'bogus'; " in done.stdout
    (episode,) = (home.data / "demo").iterdir()
    assert not (episode / names.CONTACT_SHEET).exists()
    assert (episode / names.PLOT).is_file()
    assert (episode / names.RERUN).is_file()
    tries = done.stdout[done.stdout.index("try:") :].splitlines()[1:3]
    assert tries[0].startswith("  . ")
    assert tries[0].endswith("put `station` on the path")
    assert tries[1].startswith("  station up ")


def test_at_a_terminal_progress_is_live_and_ctrl_c_ends_the_demo_in_order(home: Home) -> None:
    demo = ("demo", *SHORT, *IN_STEP)
    code, screen = at_a_terminal(home.without("STATION_ASSETS"), *demo, until="gate tracking", then=b"\x03")
    assert code == 0, screen
    for part in ("starting", "tour", "upright", "inference", "command to joints", "messages", "stop motion", "try:"):
        assert part in screen
    assert not home.bus_is_there()


def test_another_motion_and_policy_are_one_set_away(home: Home) -> None:
    done = home.run("up", "g1-demo", "--dry-run", "--set", "g1.policy=twist2", "--set", "motion.motion=builtin:bow")
    assert "start motion motion=builtin:bow" in done.stdout
    assert "tracker" not in done.stdout


def test_what_cannot_start_is_told_and_leaves_nobody_behind(home: Home, tmp_path: Path) -> None:
    (ruined := tmp_path / "walk.pkl").write_bytes(b"ruined")
    with home.running("demo", "--set", f"motion.motion={ruined}") as demo:
        code, out = demo.finish()
    assert (code, out) == (1, "")
    assert str(ruined) in demo.text
    assert demo.lines[-1] == "station: the demo recorded nothing; the lines above say why"
    assert not home.bus_is_there()
    assert are_gone([demo.process.pid])
