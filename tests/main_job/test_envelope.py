"""What operators did counts where a policy's envelope is measured: an episode, recorded by the real processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.control.envelope import read
from tests.main_job.station_runs import LOCK_STEP, Terminal, up
from tests.suite.made import limp_network

pytestmark = pytest.mark.timeout(300)


def test_an_envelope_is_measured_of_recorded_episodes_as_well(tmp_path: Path, processes: None) -> None:
    terminal, file = Terminal(tmp_path), tmp_path / "mine.envelope.yaml"
    done = terminal.run(*up("turn", "motion.motion=builtin:turn-left", *LOCK_STEP))
    assert done.returncode == 0, done.stdout + done.stderr
    words = ("rehearse", "--envelope", str(file), "--jobs", "1")

    bow = terminal.run(*words, "builtin:bow")
    assert bow.returncode == 0, bow.stderr
    alone = read(file)
    both = terminal.run(*words, "builtin:bow", "--episode", "latest")
    assert both.returncode == 0, both.stderr
    assert f"saved {file}: 29 elements of the command, from 1 motion and 1 episode" in both.stdout
    assert f"# episode {terminal.episode('turn').name}" in file.read_text()
    made = read(file)
    turns = [each.bounded.upper[each.bounded.elements.index("root_yaw_rate")] for each in (alone, made)]
    assert turns[0] < 0.1 < turns[1], "a bow does not turn, what was recorded does"

    only = terminal.run(*words, "--episode", "latest")
    assert only.returncode == 0, only.stderr
    assert only.stdout.strip().endswith("from 0 motions and 1 episode")
    other = terminal.run(*words, "--episode", "latest", "--policy", "twist2")
    for refused, told in (
        (other, "policy 'tracker' of sha256"),
        (terminal.run(*words, "--episode", "gone"), "'gone': not found"),
        (terminal.run("rehearse", "builtin:bow", "--episode", "latest"), "--episode goes with --envelope"),
    ):
        assert refused.returncode != 0
        (line,) = refused.stderr.strip().splitlines()
        assert told in line


def test_what_made_the_robot_fall_is_in_no_envelope(tmp_path: Path, processes: None) -> None:
    terminal, limp = Terminal(tmp_path), limp_network(tmp_path / "limp.onnx")
    settings = ("motion.motion=builtin:bow", f"g1.checkpoint={limp}", *LOCK_STEP)
    terminal.run(*up("limp", *settings))
    file = tmp_path / "mine.envelope.yaml"
    done = terminal.run("rehearse", "--envelope", str(file), "--episode", "latest", "--checkpoint", str(limp))
    (line,) = done.stderr.strip().splitlines()
    assert done.returncode == 2
    assert "--episode latest: the robot fell (" in line
    assert not file.exists()
