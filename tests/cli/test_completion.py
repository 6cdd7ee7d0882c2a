"""``station completion``: a shell completes what there is, and shows no error amid what is being typed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import get_completion_class
from click.testing import CliRunner

from station import packages, registry
from station.bus import contracts
from station.cli.completion import SHELLS
from station.cli.main import VERBS, cli
from station.cli.options import COMPLETION_VARIABLE, PROGRAM
from station.errors import UnknownName
from tests.cli.running import Home

BASH = """
compopt() { :; }  # only readline can answer it
. "$1"
shift
for line in "$@"; do
  COMP_WORDS=($line) COMPREPLY=()
  [ "${line% }" = "$line" ] || COMP_WORDS+=("")
  COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
  _station_completion station
  echo "$line: ${COMPREPLY[*]}"
done
"""


def completed(*words: str) -> list[str]:
    """What is offered for the last of some words, but for files."""
    made = get_completion_class("bash")
    assert made is not None
    found = made(cli, {}, PROGRAM, COMPLETION_VARIABLE).get_completions(list(words[:-1]), words[-1])
    return [item.value for item in found if item.type == "plain"]


def offers_files(*words: str) -> bool:
    made = get_completion_class("bash")
    assert made is not None
    found = made(cli, {}, PROGRAM, COMPLETION_VARIABLE).get_completions(list(words[:-1]), words[-1])
    return any(item.type == "file" for item in found)


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two tasks with episodes, and what is none."""
    for name in ("walk/2026-11-20-g1-walk-0001", "walk/2026-11-21-g1-walk-0002", "bow/2026-11-19-g1-bow-0001",
                 "bow/2026-11-19-g1-a $(touch here) b-0002", "bow/notes"):  # fmt: skip
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "bow" / "2026-11-19-g1-bow-0003").write_text("no folder")
    monkeypatch.setenv("STATION_DATA", str(tmp_path))
    return tmp_path


def test_verbs_and_options_are_completed() -> None:
    assert completed("") == list(VERBS)
    assert completed("ep") == ["episodes"]
    assert completed("record", "st") == ["start", "stop"]
    assert "--dry-run" in completed("up", "--d")


def test_runbooks_that_ship_are_completed_and_files() -> None:
    assert "g1-demo" in completed("up", "")
    assert set(completed("up", "kassow-sim")) == {path.stem for path in packages.RUNBOOKS.glob("kassow-sim*.yaml")}
    assert offers_files("up", "my")


@pytest.mark.parametrize(
    "verb", ["check", "audit", "replay", "view", "report", "enrich", "episodes show", "export csv"]
)
def test_the_newest_episodes_come_first(verb: str, data: Path) -> None:
    newest = ["2026-11-21-g1-walk-0002", "2026-11-20-g1-walk-0001", "2026-11-19-g1-bow-0001"]
    assert completed(*verb.split(), "") == ["latest", *newest]
    assert completed(*verb.split(), "2026-11-2") == newest[:2]
    assert completed(*verb.split(), "--data", str(data / "nowhere"), "") == ["latest"]
    assert offers_files(*verb.split(), "")


def test_of_many_episodes_the_newest_are_offered(data: Path) -> None:
    for number in range(100):
        (data / "walk" / f"2026-11-22-g1-walk-{number + 3:04}").mkdir()
    found = completed("check", "")
    assert found[:2] == ["latest", "2026-11-22-g1-walk-0102"]
    assert len(found) < 40


def test_names_are_completed(data: Path) -> None:
    assert completed("serve", "") == registry.names("server")
    assert completed("devices", "fake", "s") == ["spacemouse"]
    assert completed("import", "") == registry.names("foreign")
    assert completed("export", "") == registry.names("export")
    assert completed("keys", "action_b") == [each.key for each in contracts.contracts() if "action_b" in each.key]
    assert completed("export", "lerobot", "--task", "") == ["bow", "walk"]


def test_every_verb_can_be_completed(data: Path) -> None:
    for verb in VERBS:
        completed(verb, "")
        assert "--help" in completed(verb, "--h")


def test_an_option_that_prints_and_leaves_does_neither_while_a_line_is_completed(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "latest" in completed("check", "--print-rules", "")
    assert "csv" in completed("export", "--list", "")
    assert "twist2" in completed("import", "--list", "")
    assert capsys.readouterr().out == ""


def test_a_verb_that_does_not_exist_is_an_error_within_the_process() -> None:
    with pytest.raises(UnknownName):
        completed("foo", "")


@pytest.mark.parametrize("shell", ["zsh", "fish"])  # that of bash asks bash for its version: below
def test_the_script_of_a_shell_is_printed(shell: str) -> None:
    done = CliRunner().invoke(cli, ["completion", shell], prog_name=PROGRAM)
    assert done.exit_code == 0, done.output
    assert f"{COMPLETION_VARIABLE}={shell}_complete" in done.output
    assert done.output.count("_station_completion") >= 2


def test_its_help_says_how_it_is_installed() -> None:
    command = cli.get_command(click.Context(cli), "completion")
    assert command is not None
    assert command.help is not None
    for shell in SHELLS:
        assert f"station completion {shell} >" in command.help


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_and_shows_no_error(home: Home, tmp_path: Path) -> None:
    episode = home.data / "walk" / "2026-11-21-g1-walk-0002"
    episode.mkdir(parents=True)
    script = tmp_path / "script"
    script.write_text(home.run("completion", "bash").stdout)
    lines = ["station rec", "station up g1-d", "station check 2026", "station foo b", "station up --for"]
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "station").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m station "$@"\n')
    (folder / "station").chmod(0o755)
    done = subprocess.run(
        ["bash", "--norc", "-c", BASH, "bash", str(script), *lines],
        env={**home.environment, "PATH": f"{folder}:{os.environ['PATH']}"},
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        "station rec: record",
        "station up g1-d: g1-demo",
        f"station check 2026: {episode.name}",
        "station foo b: ",
        "station up --for: --for",
    ]


def test_zsh_and_fish_are_answered(home: Home) -> None:
    for shell, words, word in (("zsh", "station up g1-demo", "2"), ("fish", "station up g1-demo", "g1-demo")):
        home.environment |= {COMPLETION_VARIABLE: f"{shell}_complete", "COMP_WORDS": words, "COMP_CWORD": word}
        done = home.run()
        assert (done.returncode, done.stderr) == (0, "")
        assert "g1-demo" in done.stdout.replace(",", "\n").splitlines()
