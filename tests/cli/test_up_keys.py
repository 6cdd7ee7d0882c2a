"""The keys of ``station up`` at a real terminal: the emergency stop at any time, and a server that died."""

from __future__ import annotations

import getpass
import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station import Station
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.stamp import decode
from station.episode.storage.manifest import load_manifest
from station.errors import Refused
from tests.cli.at_terminal import AtTerminal
from tests.cli.running import COMMANDS_ONLY, SHORT, Home, one_line
from tests.cli.screen import screen
from tests.cli.stopped import release
from tests.waiting import wait_until

REPEAT_S = 1 / 30
ASK_AGAIN_S = 2.0  # Enter starts and pauses: what was asked for has been told by then
GATE = keys.command_gate(twist_keys.TWIST2_ROBOT)
HEAD = "runbook: t\nrobot: unitree_g1_with_hands\nsteps:\n"
G1 = "  - start: g1\n    with: {physics_dt_s: 0.002, real_time_priority: 0}\n    ready_within: 60s\n"
ASK = "  - confirm: Nobody stands there.\n"
MOTION = "  - start: motion\n    with: {motion: 'builtin:wave', loop: true, enter_s: 0.1, leave_s: 0.1}\n"
RECORDER = "  - start: recorder\n"


def written(folder: Path, text: str) -> str:
    path = folder / "book.yaml"
    path.write_text(HEAD + text)
    return str(path)


def gate(bus: Bus) -> str:
    return str(codec.parse_json(bus.get(GATE) or b"{}").get("state", ""))


def written_ns(bus: Bus, key: str) -> int:
    """Return when the newest native write of a key was made [ns]."""
    stamp = decode(bus.get(keys.stamp(key)) or b"")
    return stamp.mono_ns if stamp is not None else 0


def writes_of(bus: Bus, key: str) -> int:
    """Return the count of writes by the newest writer of a key."""
    stamp = decode(bus.get(keys.stamp(key)) or b"")
    return stamp.seq if stamp is not None else 0


def hold(terminal: AtTerminal, key: bytes, until: Callable[[], bool]) -> None:
    """Repeat a key, as a keyboard does while it is held down, until something is so."""

    def repeated() -> bool:
        terminal.type(key)
        time.sleep(REPEAT_S)
        return until()

    wait_until(repeated)


def press_until(terminal: AtTerminal, key: bytes, text: str, after: int) -> int:
    """Press a key again and again until the screen shows a text behind a place; return the place behind it."""

    hold(terminal, key, lambda: text in terminal.screen[after:])
    return terminal.wait_for(text, after)


def wait_for_ticks(bus: Bus) -> None:
    """Wait until the robot has made some steps more: it has acted on what was asked before."""
    before = written_ns(bus, GATE)
    wait_until(lambda: written_ns(bus, GATE) > before + 100_000_000)


def test_space_stops_the_robot_at_a_question_and_nothing_goes_past_the_stop(home: Home, tmp_path: Path) -> None:
    with AtTerminal(home, "up", written(tmp_path, G1 + ASK + MOTION)) as terminal:
        terminal.wait_for("[y/N]")
        assert terminal.settings() != terminal.before, "keys come one at a time"
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: gate(bus) == "waiting")
            terminal.type(b" ")
            wait_until(lambda: gate(bus) == "stopped")
            terminal.wait_for_any("EMERGENCY STOP: the robots are damped until `station estop --reset`",
                                  "s after the key; the robots are damped")  # fmt: skip
            told = terminal.wait_for("the robots are damped")
            terminal.type(b"x\x7fyes\r")  # the question was still open, and "yes" holds no stop
            held = terminal.wait_for("release it with `station estop --reset`; until then nothing goes on", told)
            presses = writes_of(bus, keys.ESTOP)
            terminal.type(b"x r \x1b[A\r")
            wait_until(lambda: writes_of(bus, keys.ESTOP) >= presses + 2)  # each space among them stops once more
            assert gate(bus) == "stopped"
            wait_for_ticks(bus)
            assert bus.get(twist_keys.action_body()) is None
            release(home)
            asked = terminal.wait_for("[y/N]", held)
            terminal.type(b"yes\r")
            started = terminal.wait_for("start motion", asked)
            wait_until(lambda: gate(bus) == "tracking")
            terminal.wait_for("SPACE or e: emergency stop", started)
            terminal.type(b"e")
            wait_until(lambda: gate(bus) == "stopped")
            ended = terminal.wait_for("; r starts it again, Ctrl-C takes the station down", started)
            assert "ended the motion at " in terminal.screen[started:ended]
            refused = press_until(terminal, b"r", "until then nothing starts", ended)
            release(home)
            terminal.type(b"r")
            terminal.wait_for("server-restarted", refused)
            wait_until(lambda: gate(bus) == "tracking")
        terminal.send(signal.SIGTERM)
        assert terminal.finish() == 0, terminal.screen
        assert terminal.settings() == terminal.before, "the terminal is as it was"


def test_a_question_takes_one_of_its_words_and_a_measurement_shows_how_far_it_is(home: Home, tmp_path: Path) -> None:
    question = "  - ask: How is the arm?\n    answers: [limp, stiff]\n"
    measure = "  - measure: the commands\n    stream: action_body\n    for: 60s\n    expect: {rate: {least: 1}}\n"
    with AtTerminal(home, "up", written(tmp_path, question + MOTION + measure)) as terminal:
        asked = terminal.wait_for("? How is the arm? [limp/stiff]")
        terminal.type(b"soft\n")
        again = terminal.wait_for("'soft' is no answer: expected one of limp, stiff", asked)
        terminal.wait_for("? How is the arm?", again)
        terminal.type(b"limp\n")
        answered = terminal.wait_for("ask: How is the arm?", again)
        measuring = terminal.wait_for("measure: the commands  1 of 60 s", answered)
        terminal.type(b"\x03")
        terminal.wait_for("stopped: asked to stop while it was measured", measuring)
        assert terminal.finish() == 130


def test_a_question_is_answered_by_a_console_while_somebody_types_and_the_terminal_is_told(
    home: Home, tmp_path: Path
) -> None:
    question = "  - ask: How is the arm?\n    answers: [limp, stiff]\n"
    with AtTerminal(home, "up", written(tmp_path, ASK + question + MOTION)) as terminal:
        asked = terminal.wait_for("[y/N]")
        terminal.type(b"y")
        with Station(home.bus.url) as lab:
            first = open_question(lab)
            lab.answer(first, "yes", who="anna", where="console")
            told = terminal.wait_for("Nobody stands there.  yes, by anna (console)", asked)
            again = terminal.wait_for("? How is the arm? [limp/stiff]", told)
            second = open_question(lab, after=first)
            terminal.type(b"limp\r")
            terminal.wait_for("ask: How is the arm?", again)
            with pytest.raises(Refused, match=rf"answered: limp, by {getpass.getuser()} \(terminal\)"):
                lab.answer(second, "stiff", who="anna", where="console")
        terminal.send(signal.SIGINT)
        terminal.finish()


def test_where_nobody_can_type_a_station_waits_for_a_console_if_it_is_told_to(home: Home, tmp_path: Path) -> None:
    book = written(tmp_path, ASK + MOTION)
    with home.running("up", book) as station:
        station.wait_for("nobody is here to answer; use --yes in simulation, or --ask console")
        assert station.finish()[0] == 1
    with home.running("up", book, "--ask", "console") as station:
        station.wait_for("waiting for an answer from a console: Nobody stands there.")
        with Station(home.bus.url) as lab:
            lab.answer(open_question(lab), "yes", who="anna", where="console")
            station.wait_for("motion: motion-start")
            os.kill(home.pids()["motion"], signal.SIGKILL)
            lab.answer(open_question(lab), "restart", who="anna", where="console")
            station.wait_for("server-restarted server=motion")
            station.wait_for("server-active server=motion")
        station.interrupt()
        assert station.finish()[0] == 0
    with home.running("up", book, "--ask", "console") as station:
        station.wait_for("waiting for an answer from a console")
        station.interrupt()
        assert station.finish()[0] == 130
    assert "--yes asks nobody" in one_line(home.run("up", book, "--yes", "--ask", "console"))


def open_question(lab: Station, after: str = "") -> str:
    """Wait for the question that is asked now, and return its id."""
    found: list[str] = []

    def is_open() -> bool:
        status = lab.runbook()
        found[:] = [] if status is None or status.question is None else [status.question.id]
        return bool(found) and found != [after]

    wait_until(is_open)
    return found[0]


def test_keys_drive_from_this_terminal_and_space_stops_here_too(home: Home, tmp_path: Path) -> None:
    teleop = "  - start: teleop\n    with: {device: keyboard, driver: walk}\n    ready_within: 60s\n"
    with AtTerminal(home, "up", written(tmp_path, G1 + ASK + "  - start: keyboard\n" + teleop)) as terminal:
        terminal.wait_for("[y/N]")
        terminal.type(b"y\r")
        place = terminal.wait_for("press key_enter to drive")
        terminal.wait_for("w s forwards and back")
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            asked_s = -math.inf

            def walks() -> bool:
                """Also engage, and again where a robot that had no commands for a while has let go of its operator."""
                nonlocal asked_s
                if not home.health()["teleop"].detail["engaged"] and time.monotonic() > asked_s + ASK_AGAIN_S:
                    terminal.type(b"\r")
                    asked_s = time.monotonic()
                return float(codec.parse_json_vector(bus.get(twist_keys.action_body()) or b"[0]")[0]) > 0.0

            hold(terminal, b"w", walks)
            terminal.type(b"\x1b[A ")  # an arrow comes with it: it stops all the same
            wait_until(lambda: gate(bus) == "stopped")
        terminal.wait_for("EMERGENCY STOP", place)
        terminal.send(signal.SIGINT)
        assert terminal.finish() == 0, terminal.screen
        assert terminal.settings() == terminal.before
        assert "help w s" not in terminal.screen, "said once, in a line of its own"


def test_space_stops_the_robot_while_a_step_waits_for_a_server(home: Home, tmp_path: Path) -> None:
    check = "  - check: key-rate\n    key: nobody\n    min_hz: 1\n    within_s: 3600\n"
    with AtTerminal(home, "up", written(tmp_path, G1 + check)) as terminal:
        terminal.wait_for("check key-rate")
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: gate(bus) == "waiting")
            terminal.type(b" ")
            wait_until(lambda: gate(bus) == "stopped")
        terminal.send(signal.SIGTERM)
        terminal.wait_for("asked to stop while writes of nobody were counted")
        assert terminal.finish() == 130


def test_a_server_that_dies_leaves_the_station_up_and_r_starts_it_again(home: Home, tmp_path: Path) -> None:
    book = written(tmp_path, G1 + RECORDER + MOTION)
    with AtTerminal(home, "up", book, "--record", "--task", "t") as terminal:
        place = terminal.wait_for("start motion")
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: gate(bus) == "tracking")
            for name in ("motion", "g1"):
                pid = home.pids()[name]
                os.kill(pid, signal.SIGKILL)
                place = terminal.wait_for(f"server '{name}' was killed by SIGKILL; its last words: ", place)
                terminal.wait_for("; r starts it again, Ctrl-C takes the station down", place)
                place = terminal.wait_for(f"r: start {name} again", place)
                if name == "motion":
                    wait_until(lambda: gate(bus) == "waiting")  # standing, and the station is up
                terminal.type(b"r")
                wait_until(lambda name=name, pid=pid: home.pids().get(name, pid) != pid)  # type: ignore[misc]
                wait_until(lambda: home.health()["g1"].detail.get("gate") == "tracking")
        terminal.send(signal.SIGINT)
        assert terminal.finish() == 0, "whoever died was started again"
    found = [event for event in load_manifest(_newest(home)).events if event.source == "supervisor"]
    died = [event.numbers["server"] for event in found if event.name == "server-died"]
    again = [(event.numbers["server"], event.numbers["who"]) for event in found if event.name == "server-restarted"]
    assert died == ["motion", "g1"]
    assert again == [("motion", getpass.getuser()), ("g1", getpass.getuser())]


def test_a_server_that_died_and_stays_dead_is_no_success(home: Home) -> None:
    with AtTerminal(home, "up", COMMANDS_ONLY, "--set", "motion.loop=true", *SHORT) as terminal:
        terminal.wait_for("motion: motion-start")
        os.kill(home.pids()["motion"], signal.SIGKILL)
        terminal.wait_for("r starts it again")
        assert "recorder" in home.pids(), "the station is up"
        terminal.send(signal.SIGINT)
        assert terminal.finish() == 1
        assert " stop recorder" in terminal.screen


def test_a_server_that_is_frozen_is_told_of_and_can_be_replaced(home: Home) -> None:
    with AtTerminal(home, "up", COMMANDS_ONLY, "--set", "motion.loop=true", *SHORT) as terminal:
        terminal.wait_for("motion: motion-start")
        pid = home.pids()["motion"]
        os.kill(pid, signal.SIGSTOP)
        terminal.wait_for("server 'motion' lives, but has said nothing for 3 s (frozen?); r starts it again")
        terminal.type(b"r")
        wait_until(lambda: home.pids().get("motion", pid) != pid)
        terminal.send(signal.SIGINT)
        assert terminal.finish() == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM])
def test_the_terminal_is_put_back_however_it_ends(home: Home, tmp_path: Path, number: signal.Signals) -> None:
    with AtTerminal(home, "up", written(tmp_path, ASK + MOTION)) as terminal:
        terminal.wait_for("[y/N]")
        assert terminal.settings() != terminal.before
        terminal.send(number)
        assert terminal.finish() == 130
        assert terminal.settings() == terminal.before


def test_a_stop_that_no_bus_takes_is_told_loudly_and_tried_on(home: Home) -> None:
    with AtTerminal(home, "up", COMMANDS_ONLY, "--set", "motion.loop=true", *SHORT) as terminal:
        terminal.wait_for("motion: motion-start")
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            text = bus.call("INFO", "server").decode()
            pid = int(text.split("process_id:")[1].split()[0])
        os.kill(pid, signal.SIGSTOP)
        try:
            terminal.type(b" ")
            place = terminal.wait_for("EMERGENCY STOP: the stop was NOT taken (bus ")
            terminal.wait_for("use the robot's own stop", place)
        finally:
            os.kill(pid, signal.SIGCONT)
        terminal.wait_for("EMERGENCY STOP: taken", place)
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            assert b'"stop":true' in (bus.get(keys.ESTOP) or b"")
        terminal.wait_for("ended the motion at ", place)
        terminal.send(signal.SIGINT)
        assert terminal.finish() == 1, "what commanded has ended with the stop"


def test_past_a_frozen_bus_the_key_still_stops_the_robot_of_this_station(home: Home, tmp_path: Path) -> None:
    with AtTerminal(home, "up", written(tmp_path, G1 + MOTION)) as terminal:
        terminal.wait_for("motion: motion-start")
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: gate(bus) == "tracking")
            pid = int(bus.call("INFO", "server").decode().split("process_id:")[1].split()[0])
        os.kill(pid, signal.SIGSTOP)
        try:
            terminal.type(b" ")
            (log,) = Path(home.environment["XDG_RUNTIME_DIR"]).rglob("g1.log")
            said = f"estop reason={getpass.getuser()}, key in `station up`"
            wait_until(lambda: said in log.read_text())
        finally:
            os.kill(pid, signal.SIGCONT)
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: gate(bus) == "stopped")
        terminal.wait_for("ended the motion at ")
        terminal.wait_for("r starts it again")
        terminal.send(signal.SIGTERM)
        assert terminal.finish() == 1, "the motion has ended with the stop"


def _newest(home: Home) -> Path:
    return max(home.data.glob("*/*/manifest.yaml"), key=lambda path: path.stat().st_mtime).parent


def test_a_narrow_screen_holds_all_that_is_drawn_on_it(home: Home, tmp_path: Path) -> None:
    """All that is drawn again and again fits, and says what the keys do and how the servers are."""
    with AtTerminal(home, "up", written(tmp_path, G1 + RECORDER + MOTION), columns=60) as terminal:
        terminal.wait_for("gate tracking")
        terminal.send(signal.SIGINT)
        assert terminal.finish() == 0
    drawn = screen(terminal.screen).drawn
    assert [line for line in drawn if len(line) > 60] == []
    for words in ("SPACE or e: emergency stop", "Ctrl-C", "gate tracking"):
        assert any(words in line for line in drawn), drawn[-20:]
    for server in ("g1", "recorder", "motion"):
        assert any(line.startswith(server) and "active" in line for line in drawn), drawn[-20:]
