"""A robot twin as its own process: its faults by command line, script and settings, and what it says of bad ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.robots.g1.twin.kind import KIND
from servers.robot_twin import FaultSwitches, TwinConfig, read_script
from station.errors import BadFile, ConfigError
from tests.cli.running import Home, new_home
from tests.dds_domains import domain
from tests.waiting import wait_until


@pytest.fixture(scope="module")
def home(processes: None) -> Iterator[Home]:
    """A place where a twin runs, whose script lets it down after a moment."""
    with new_home() as found, domain() as number:
        script = Path(found.environment["XDG_RUNTIME_DIR"]) / "script.yaml"
        script.write_text("- {at_s: 0.5, gantry: down}\n- {at_s: 1.0, soc: 50}\n")
        with found.running("bus", "start"):
            wait_until(found.bus_is_there)
            sets = ("--set", f"options.domain={number}", "--set", f"script={script}", "--set", "faults.voltage=52")
            with found.running("robot-twin", "g1", *sets):
                wait_until(lambda: found.health().get("robot-twin") and "faults" in found.health()["robot-twin"].detail)
                yield found


def test_settings_and_a_script_switch_its_faults(home):
    wait_until(lambda: home.health()["robot-twin"].detail["faults"] == {"gantry": "down", "soc": 50.0, "voltage": 52.0})
    wait_until(lambda: home.health()["robot-twin"].detail["pelvis_m"] < 0.8)


def test_the_command_line_switches_faults_and_shows_how_it_is(home):
    done = home.run("robot-twin", "g1", "winding_c.left_knee=121", "remote=[L2, B]")
    assert done.returncode == 0, done.stderr
    assert '"winding_c": {"left_knee": 121.0}' in done.stdout
    assert '"remote": ["L2", "B"]' in done.stdout
    assert "is_damped: true" in home.run("robot-twin", "g1", "remote=[]").stdout
    assert "faults: {}" in home.run("robot-twin", "g1", "--well").stdout


@pytest.mark.parametrize(("words", "code", "said"), [
    (["g1", "gantri=slack"], 1, "unknown key 'gantri' (did you mean 'gantry'?)"),
    (["g1", "gantry=high"], 1, "hung"),
    (["g1", "remote=[Z]"], 1, "'Z' is none of R1"),
    (["g1", "state_drop=2"], 1, "state_drop"),
    (["g1", "gantry"], 2, "expected key=value"),
    (["g1", "gantry=down", "--set", "faults.soc=3"], 2, "--set is for a twin that is started"),
    (["g9"], 2, "unknown twin 'g9'"),
])  # fmt: skip
def test_what_it_does_not_know_is_one_line(home, words, code, said):
    done = home.run("robot-twin", *words)
    assert (done.returncode, said in done.stderr, done.stderr.count("\n")) == (code, True, 1), done.stderr


def test_a_twin_that_does_not_run_is_named(processes):
    with new_home() as empty, empty.running("bus", "start"):
        wait_until(empty.bus_is_there)
        done = empty.run("robot-twin", "g1", "gantry=down")
        assert done.returncode == 1
        assert "no twin 'g1' runs on" in done.stderr


@pytest.mark.parametrize(("text", "words"), [
    ("a: 1", "expected a list, each row with at_s"),
    ("- {at_s: 1, gantri: x}", "row 1"),
    ("- {gantry: down}", "at_s is None; expected seconds"),
    ("- {at_s: 3, gantry: down}\n- {at_s: 2, gantry: hung}", "row 2: at_s is 2"),
    ("- [", "not YAML"),
])  # fmt: skip
def test_a_bad_script_is_one_line(tmp_path, text, words):
    path = tmp_path / "script.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"script.yaml") as caught:
        read_script(path, KIND)
    assert words in str(caught.value)


def test_a_script_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BadFile, match=r"script.yaml: cannot be read: No such file"):
        read_script(tmp_path / "script.yaml", KIND)


def test_faults_that_are_refused_change_nothing():
    switches = FaultSwitches(KIND, {"soc": 50.0})
    with pytest.raises(ValueError, match="unknown key 'no'"):
        switches.change({"no": 1, "soc": 20.0})
    assert switches.shown() == {"soc": 50.0}


def test_settings_are_checked_before_anything_starts():
    with pytest.raises(ValueError, match="mode_machine"):
        TwinConfig(twin="g1", options={"mode_machine": 9})
    with pytest.raises(ValueError, match="unknown twin 'g2'"):
        TwinConfig(twin="g2")
