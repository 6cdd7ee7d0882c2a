"""Output that cannot be written, or not as it is: a line and an exit code, never a traceback."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import Wave
from tests.cli.running import Home, new_home

VERBS_OF_GROUPS = ("record", "episodes", "devices", "kassow", "bus", "assets", "runbooks")
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


def test_a_report_begins_with_what_the_robot_did_and_shows_bookkeeping_on_demand(wave: Wave) -> None:
    short, whole = (wave.home.run("check", str(wave.episode), "--no-write", *more).stdout for more in ([], ["--all"]))
    # The last, that of the table: where the machine was late, a reason above names the key as well.
    assert short.index("still for ") < short.rindex("action_body_unitree_g1_with_hands")
    assert "station:server:motion" not in short
    assert "streams of the station's own, none with a write lost; --all shows them" in short
    assert "station:server:motion" in whole
    assert "--all" not in whole


@pytest.mark.parametrize("verb", VERBS_OF_GROUPS)
def test_the_help_of_a_group_cuts_no_sentence(home: Home, verb: str) -> None:
    listed = home.run(verb, "--help").stdout.partition("Commands:")[2]
    assert listed
    assert "..." not in listed


def test_episodes_that_were_never_checked_are_left_out_with_a_word(wave: Wave) -> None:
    with new_home() as home:
        shutil.copytree(wave.episode, home.data / "wave" / wave.episode.name)
        done = home.run("episodes", "list", "--min-quality", "usable")
        assert "no episode in " in done.stdout
        assert done.stderr == (
            "station: 1 left out that were never checked; `station check` them, --verdict unchecked lists them\n"
        )
        home.run("check", "latest")
        assert home.run("episodes", "list", "--min-quality", "usable").stderr == ""
