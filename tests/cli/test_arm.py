"""``station arm`` and ``station disarm``, and the steps of a runbook that do the same."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.client import Bus
from tests.cli.running import Home, Running, new_home, one_line
from tests.cli.stopped import press, release
from tests.waiting import wait_until

BOOK = """
runbook: armed-by-step
robot: unitree_g1_with_hands
steps:
  - start: g1
    with:
      start_armed: false
      physics_dt_s: 0.002
      real_time_priority: 0
      gate: {hold_after_s: 20, return_after_s: 60}  # no robot is armed while it is left by a late commander
    ready_within: 60s
  - confirm: "Everybody is clear."
  - arm: g1
  - start: motion
    with: {motion: "builtin:stand", loop: true, enter_s: 0.1, leave_s: 0.1}
on_failure: [stop: motion, stop: g1]
"""


@pytest.fixture(scope="module")
def armed(processes: None) -> Iterator[tuple[Home, Running]]:
    """A simulated robot that started disarmed and was armed by its runbook."""
    with new_home() as home:
        book = Path(home.environment["XDG_RUNTIME_DIR"]) / "book.yaml"
        book.write_text(BOOK)
        with home.running("up", str(book), "--yes") as station:
            station.wait_for("to=tracking")
            yield home, station


def arming(home: Home) -> str:
    with Bus(home.bus, name="test", timeout_s=5.0) as bus:
        return str(codec.parse_json(bus.get(keys.command_gate(twist_keys.TWIST2_ROBOT)) or b"{}").get("arming"))


def test_a_runbook_arms_in_its_order_and_says_so(armed: tuple[Home, Running]) -> None:
    _, station = armed
    lines = station.lines
    places = [next(n for n, line in enumerate(lines) if text in line)
              for text in ("✓ start g1", "✓ confirm", "✓ arm g1", "✓ start motion")]  # fmt: skip
    assert places == sorted(places)
    assert "armed, at full stiffness" in lines[places[2]]
    assert any("g1: arming who=" in line for line in lines)


def test_disarm_and_arm_say_what_happened_and_status_shows_it(armed: tuple[Home, Running]) -> None:
    home, station = armed
    told = len(station.lines)
    done = home.run("disarm", "g1", "--reason", "lunch")
    assert (done.returncode, done.stdout) == (0, "g1: disarmed: its policy runs, nothing is sent to the robot\n")
    station.wait_for("g1: disarmed who=")
    wait_until(lambda: home.health()["g1"].detail["arming"] == "disarmed")
    assert "arming disarmed" in home.run("status").stdout
    done = home.run("arm")
    assert (done.returncode, done.stdout) == (0, "g1: armed, at full stiffness\n")
    wait_until(lambda: any("g1: arming who=" in line for line in station.lines[told:]))
    assert arming(home) == "armed"
    assert home.run("arm", "g1").stdout == "g1: armed already\n"


def test_arming_against_a_latched_stop_is_refused_with_the_reason_and_exit_code_1(home: Home, tmp_path: Path) -> None:
    book = tmp_path / "book.yaml"
    book.write_text(
        BOOK[: BOOK.index("  - start: motion")]
    )  # a motion would end with the stop, and the station with it
    with home.running("up", str(book), "--yes") as station:
        station.wait_for("✓ arm g1")
        press(home, "--reason", "a test")
        station.wait_for("to=stopped")
        done = home.run("arm")
        assert done.returncode == 1
        assert "g1 is not armed: the emergency stop is latched" in one_line(done)
        release(home)
        wait_until(lambda: arming(home) == "disarmed")
        wait_until(lambda: home.run("arm").returncode == 0)


def test_who_is_not_there_is_named(armed: tuple[Home, Running]) -> None:
    home, _ = armed
    told = f"no low-level server g2 runs on {home.bus} (there are: g1); start a station first"
    wait_until(lambda: one_line(home.run("arm", "g2")).startswith(told))  # one whose heartbeat is late is not there
