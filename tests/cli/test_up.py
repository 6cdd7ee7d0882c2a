"""``station up``: a runbook from the first check to the last farewell, and every way in which it may end."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

from tests.cli.at_terminal import AtTerminal, at_a_terminal
from tests.cli.conftest import Wave
from tests.cli.running import COMMANDS_ONLY, SHORT, Home, are_gone, one_line
from tests.waiting import wait_until

FOREVER = ("--set", "motion.loop=true", *SHORT)
UNENDING = "  - check: key-rate\n    key: nobody\n    min_hz: 1\n    within_s: 3600\n  - start: recorder"
"""Steps of a start that does not come to its end."""
G1_LOADS_FOR_EVER = """
import sys, time
if "g1" in sys.orig_argv:
    time.sleep(3600)
"""
"""Found by each Python of a station, and obeyed by its robot."""
RECORDED = ("--yes", "--record", "--task", "t", *FOREVER)


def test_a_dry_run_prints_the_plan_and_starts_nothing(home: Home) -> None:
    done = home.run("up", COMMANDS_ONLY, "--dry-run", "--set", "motion.loop=true")
    assert done.returncode == 0
    assert "start recorder" in done.stdout
    assert "start motion motion=builtin:wave loop=True  (ready within 20 s)" in done.stdout
    assert "at the end, stop: motion, recorder" in done.stdout
    assert not home.bus_is_there()
    assert not home.data.exists()


def test_a_run_ends_with_its_motion_and_leaves_a_finished_episode(wave: Wave) -> None:
    assert wave.code == 0, wave.station.text
    assert (wave.episode / "signals.mcap").is_file(), "stdout is the folder of the episode and nothing else"
    assert wave.episode.parent.name == "wave"
    told = wave.station.text
    steps = ["✓ check bus", "✓ start recorder", "· recording", "✓ start motion", "· motion: motion-start",
             "· motion has finished", "✓ stop motion", "✓ stop recorder", "0 lost"]  # fmt: skip
    places = [told.find(step) for step in steps]
    assert places == sorted(places)
    assert -1 not in places


def test_the_manifest_holds_what_was_asked_for_and_answered(wave: Wave) -> None:
    facts = wave.home.json("episodes", "show", str(wave.episode))["manifest"]
    assert facts["task"] == {"name": "wave", "instruction": "wave your hand"}
    assert facts["operator"]["id"] == "ada"
    assert facts["runbook"]["name"] == COMMANDS_ONLY
    assert [answer["step"] for answer in facts["runbook"]["answers"]] == ["check bus"]
    assert facts["runbook"]["answers"][0]["is_unattended"] is False, "a check asks nobody"


def test_ctrl_c_takes_the_station_down_in_order_and_closes_the_episode(home: Home) -> None:
    with home.running("up", COMMANDS_ONLY, *RECORDED) as station:
        station.wait_for("· motion: motion-start")
        pids = list(home.pids().values())
        station.interrupt()
        code, out = station.finish()
    assert code == 0, station.text
    assert station.text.index("✓ stop motion") < station.text.index("✓ stop recorder")
    assert are_gone(pids)
    assert home.json("episodes", "show", out.strip())["manifest"]["state"] == "finished"


def test_ctrl_c_while_a_server_loads_does_not_wait_for_it(home: Home, tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(G1_LOADS_FOR_EVER)
    home.environment["PYTHONPATH"] = str(tmp_path)
    with home.running("up", "g1-sim-motion", *RECORDED) as station:
        station.wait_for("✓ check bus")
        station.interrupt()
        code, out = station.finish()
    assert code == 130, station.text
    assert out == ""
    assert "stopped: asked to stop before" in station.text
    assert not home.data.exists() or not list(home.data.glob("*/*"))


def test_ctrl_c_during_the_start_stops_what_has_started(home: Home, tmp_path: Path) -> None:
    book = written(tmp_path, "- start: motion\n    with: {motion: 'builtin:wave', loop: true}\n" + UNENDING)
    with home.running("up", str(book), *RECORDED) as station:
        station.wait_for("✓ start motion")
        pids = list(home.pids().values())
        station.interrupt()
        code, out = station.finish()
    assert code == 130, station.text
    assert out == ""
    assert "stopped: asked to stop " in station.text
    assert "✓ stop motion" in station.text
    assert are_gone(pids)
    assert not home.data.exists() or not list(home.data.glob("*/*"))


def test_a_second_ctrl_c_waits_for_no_order(home: Home) -> None:
    slow = ("--yes", "--record", "--task", "t", "--set", "motion.loop=true", "--set", "motion.leave_s=30")
    with home.running("up", COMMANDS_ONLY, *slow) as station:
        station.wait_for("· motion: motion-start")
        pids = list(home.pids().values())
        station.interrupt()
        station.wait_for("· stopped")
        station.interrupt()
        station.wait_for("interrupted again: stopping everything now")
        station.interrupt()
        code, _ = station.finish()
    assert code == 130, station.text
    wait_until(lambda: are_gone(pids))


def test_when_a_server_dies_its_last_words_are_told_and_the_rest_is_stopped(home: Home) -> None:
    with home.running("up", COMMANDS_ONLY, *RECORDED) as station:
        station.wait_for("· motion: motion-start")
        pids = home.pids()
        os.kill(pids["motion"], signal.SIGKILL)
        code, out = station.finish()
    assert code == 1
    told = re.compile(r"✗ server 'motion' was killed by SIGKILL; its last words: [A-Z] station\.(.*)")
    (words,) = (found[1] for line in station.lines if (found := told.fullmatch(line)) is not None)
    # A bus that owes an answer, as on a busy machine, may be the last that it speaks of.
    assert words.startswith(("life.event_publisher: ", "life.server: to be said again", "bus.client: "))
    assert "✗ stop motion  already was killed by SIGKILL" in station.text
    assert are_gone(list(pids.values()))
    shown = home.json("check", out.strip())
    assert sum(stream["lost"] for stream in shown["streams"]) == 0


def test_what_cannot_start_is_told_at_once_and_leaves_no_episode(home: Home, tmp_path: Path) -> None:
    ruined = tmp_path / "walk.pkl"
    ruined.write_bytes(b"ruined")
    done = home.run("up", COMMANDS_ONLY, "--yes", "--record", "--set", f"motion.motion={ruined}")
    assert done.returncode == 1
    assert done.stdout == ""
    assert "✗ failed: server 'motion' ended with code 2 while loading" in done.stderr
    assert f"{ruined}: " in done.stderr
    assert not home.data.exists() or not list(home.data.glob("*/*"))


def test_kill_9_of_the_supervisor_leaves_nobody_and_a_readable_episode(home: Home) -> None:
    with home.running("up", COMMANDS_ONLY, *RECORDED) as station:
        station.wait_for("· motion: motion-start")
        pids = list(home.pids().values())
        station.process.kill()
        wait_until(lambda: are_gone(pids))
    wait_until(lambda: not home.bus_is_there())
    quality = home.json("check", "latest")
    assert quality["messages"] > 0
    assert sum(stream["lost"] for stream in quality["streams"]) == 0


def test_a_second_station_on_the_same_bus_is_refused(live: Home) -> None:
    before = live.pids()
    line = one_line(live.run("up", COMMANDS_ONLY, "--yes"))
    assert line.startswith("server 'motion' already runs on unix://")
    assert "(by `station up` with pid " in line
    assert "stop that station first (`station down`), or use another bus with --bus" in line
    assert live.pids() == before


def test_without_a_recorder_nothing_can_be_recorded(home: Home, tmp_path: Path) -> None:
    book = written(tmp_path, "- start: motion\n    with: {motion: 'builtin:wave'}")
    line = one_line(home.run("up", str(book), "--record"))
    assert line == "runbook t starts no recorder; add the step `- start: recorder`, or leave out --record"


def test_where_nobody_can_answer_nothing_moves(home: Home, tmp_path: Path) -> None:
    book = written(tmp_path, "- confirm: Nobody stands there.\n  - start: motion\n    with: {motion: 'builtin:wave'}")
    done = home.run("up", str(book))
    assert done.returncode == 1
    assert "✗ nobody is here to answer; use --yes in simulation" in done.stderr
    assert "✗ failed: not confirmed: Nobody stands there." in done.stderr
    assert "start motion" not in done.stderr


def test_ctrl_c_at_a_question_is_an_answer(home: Home, tmp_path: Path) -> None:
    book = written(tmp_path, "- confirm: Nobody stands there.\n  - start: motion\n    with: {motion: 'builtin:wave'}")
    code, screen = at_a_terminal(home, "up", str(book), until="[y/N]", then=b"\x03")
    assert code == 130, screen
    assert "stopped: not confirmed" in screen


def test_a_person_at_a_terminal_says_yes_and_sees_the_servers(home: Home, tmp_path: Path) -> None:
    book = written(tmp_path, "- confirm: Nobody stands there.\n  - start: motion\n    with: {motion: 'builtin:wave'}")
    with AtTerminal(home, "up", str(book), "--for", "1s", *SHORT) as terminal:
        place = terminal.wait_for("[y/N]")
        terminal.type(b"maybe\r")
        place = terminal.wait_for("'maybe' is no answer: y goes on; n, or Enter alone, takes the station down", place)
        terminal.wait_for("[y/N]", place)
        terminal.type(b"y\r")
        code, screen = terminal.finish(), terminal.screen
    assert code == 0, screen
    assert "1 s are over" in screen
    assert "jitter p50 / p99" in screen, "the table of the servers is shown below the steps"


def written(folder: Path, steps: str) -> Path:
    path = folder / "book.yaml"
    path.write_text(f"runbook: t\nrobot: unitree_g1_with_hands\nsteps:\n  {steps}\n")
    return path
