"""Output that cannot be written, or not as it is: a line and an exit code, never a traceback."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import Wave
from tests.cli.running import Home

pytestmark = pytest.mark.usefixtures("processes")

RUN = "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); from station.cli.main import main; main()"
VERBS = (["keys"], ["doctor"], ["runbooks", "list"], ["settings", "g1"], ["--help"])


def run_into(home: Home, file: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a verb whose stdout is a file."""
    with Path(file).open("w") as out:
        return subprocess.run(
            [sys.executable, "-m", "station", *arguments], env=home.environment, stdout=out, stderr=subprocess.PIPE,
            text=True, timeout=60, check=False,
        )  # fmt: skip


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_a_full_disk_is_told_in_a_line(home: Home, verb: list[str]) -> None:
    done = run_into(home, "/dev/full", *verb)
    assert (done.returncode, done.stderr) == (1, "station: the output: cannot be written: No space left on device\n")


@pytest.mark.parametrize("coding", ["latin-1", "cp1252"])
def test_a_terminal_without_a_mark_shows_another_in_its_place(wave: Wave, coding: str) -> None:
    wave.home.environment["PYTHONIOENCODING"] = coding
    try:
        for verb in (["check", str(wave.episode), "--no-write"], ["doctor"], ["up", "commands-only", "--dry-run"]):
            done = subprocess.run(
                [sys.executable, "-m", "station", *verb], env=wave.home.environment, capture_output=True, timeout=60,
                check=False,
            )  # fmt: skip
            assert done.stdout.decode(coding), done.stderr
            assert b"Traceback" not in done.stderr
            assert b"Error" not in done.stderr
    finally:
        del wave.home.environment["PYTHONIOENCODING"]


def test_a_manifest_that_cannot_be_written_costs_the_report_nothing(wave: Wave) -> None:
    """No file of the process may grow, as where the disk or the folder is not the user's."""
    manifest = (wave.episode / "manifest.yaml").read_bytes()
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); {RUN}"
    done = subprocess.run(
        [sys.executable, "-c", limit, "check", str(wave.episode)], env=wave.home.environment, capture_output=True,
        text=True, timeout=60, check=False,
    )  # fmt: skip
    assert "0 lost" in done.stdout
    assert "the verdict is not kept there (--no-write asks for none)" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.returncode == (1 if "reject" in done.stdout.splitlines()[0] else 0)
    assert (wave.episode / "manifest.yaml").read_bytes() == manifest


def test_an_episode_that_cannot_be_checked_has_another_exit_code_than_one_to_reject(wave: Wave) -> None:
    done = wave.home.run("check", "no-such-episode")
    assert done.returncode == 2
    assert done.stderr.startswith("station: episode 'no-such-episode': not found in ")
