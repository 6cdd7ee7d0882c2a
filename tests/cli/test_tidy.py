"""``station episodes success|tag|rename|undo|prune|restore`` as a user types them."""

from __future__ import annotations

import fcntl
import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from click.testing import CliRunner

from station.cli.main import cli
from station.episode.storage.manifest import load_manifest
from station.errors import StationError
from tests.cli.test_completion import completed
from tests.episode.synthetic import EpisodeBuilder


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four episodes of 2026: one good, one to be rejected, one discarded, one of another task."""
    monkeypatch.setenv("STATION_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    verdicts: dict[int, dict[str, Any]] = {1: {"quality": {"verdict": "good"}}, 2: {"quality": {"verdict": "reject"}},
                                           3: {"quality_flags": {"discarded": True}}}  # fmt: skip
    for number in (1, 2, 3, 4):
        builder = EpisodeBuilder(tmp_path, task="jog" if number == 4 else "walk", number=number)
        builder.write({"own": b"[1]"}, at_s=0.1)
        started = {"timing": {"started": f"2026-0{number}-01T12:00:00+00:00"}}
        builder.finish({**started, **verdicts.get(number, {})})
    return tmp_path


class Done(NamedTuple):
    """Exit code of a command, what it printed, and all that it said."""

    exit_code: int
    stdout: str
    output: str


def station(*words: str) -> Done:
    found = CliRunner().invoke(cli, ["episodes", *words])
    if isinstance(found.exception, StationError):  # as `main` shows it
        return Done(found.exception.exit_code, found.stdout, f"{found.output}station: {found.exception}")
    assert found.exception is None or isinstance(found.exception, SystemExit), found.exception
    return Done(found.exit_code, found.stdout, found.output)


def listed(*words: str) -> list[str]:
    return sorted(row["episode_id"][-4:] for row in json.loads(station("list", "--json", *words).stdout))


def name(number: int) -> str:
    return f"2026-11-21-g1-{'jog' if number == 4 else 'walk'}-000{number}"


def test_success_and_tags_of_several_are_set_listed_and_undone(data: Path) -> None:
    done = station("success", name(1), name(2), "yes", "--by", "ada")
    assert (done.exit_code, done.output.splitlines()[0]) == (0, f"{name(1)} success yes (was unknown)")
    assert listed("--success", "yes") == ["0001", "0002"]
    assert station("tag", name(1), name(3), "+good", "-hazy").output.splitlines()[0] == f"{name(1)} tags: good"
    station("tag", name(3), "+night")
    assert listed("--tag", "good") == ["0001", "0003"]
    assert listed("--tag", "good", "--tag", "night") == ["0003"]
    assert "good, night" in station("list").output
    assert station("undo", name(3)).output.startswith(f"{name(3)} tags is good again, not good, night")
    assert listed("--tag", "night") == []
    assert station("undo", name(1), "--by", "bob").exit_code == 0
    assert station("undo", name(1), "--by", "bob").exit_code == 0
    edits = load_manifest(data / "walk" / name(1)).edits
    assert (edits[0].what, edits[0].by, edits[0].undone[-6:]) == ("success", "ada", "by bob")
    assert station("undo", name(1)).exit_code == 1


def test_a_rename_moves_and_is_undone(data: Path) -> None:
    station("rename", name(1), "--task", "Big Jump")
    assert listed("--task", "Big Jump") == ["0001"]
    assert (data / "big-jump" / name(1)).is_dir()
    station("undo", name(1))
    assert (data / "walk" / name(1)).is_dir()
    assert listed("--task", "Big Jump") == []


@pytest.mark.parametrize(
    ("options", "gone"),
    [
        (("--verdict", "reject"), ["0002"]), (("--discarded",), ["0003"]),
        (("--older-than", "2026-02-15"), ["0001", "0002"]),
        (("--task", "jog"), ["0004"]), (("--task", "walk", "--verdict", "unchecked"), ["0003"]),
        ((name(1), name(4)), ["0001", "0004"]), ((name(1), name(4), "--task", "walk"), ["0001"]),
        (("--older-than", "2026-02-15", "--discarded"), []),
    ],
)  # fmt: skip
def test_prune_moves_what_fits_every_option_and_a_dry_run_only_says_so(
    data: Path, options: tuple[str, ...], gone: list[str]
) -> None:
    dry = json.loads(station("prune", *options, "--dry-run", "--json").stdout)
    assert sorted(one["episode_id"][-4:] for one in dry) == gone
    assert listed() == ["0001", "0002", "0003", "0004"]
    assert not (data / ".bin").exists()
    assert station("prune", *options).exit_code == 0
    assert listed("--bin") == gone
    assert listed() == [number for number in ("0001", "0002", "0003", "0004") if number not in gone]


def test_what_was_pruned_says_when_why_and_by_whom_and_comes_back(data: Path) -> None:
    done = station("prune", "--verdict", "reject", "--by", "ada")
    assert "1 episode, 0.0 MB, moved into the bin (verdict reject)" in done.output
    (edit,) = load_manifest(data / ".bin" / "walk" / name(2)).edits
    assert (edit.what, edit.by, edit.after) == ("bin", "ada", "verdict reject")
    assert station("show", str(data / ".bin" / "walk" / name(2))).exit_code == 0
    refused = station("success", str(data / ".bin" / "walk" / name(2)), "yes")
    assert (refused.exit_code, "lies in the bin; take it back first" in refused.output) == (1, True)
    assert completed("episodes", "restore", "") == [name(2)]
    assert station("restore", name(2)).output.startswith(f"{name(2)} is back")
    assert listed() == ["0001", "0002", "0003", "0004"]
    assert station("undo", name(2)).exit_code == 1, "what a person changed is undone, not a way through the bin"


def test_the_bin_is_emptied_only_when_somebody_says_so(data: Path) -> None:
    station("prune", name(1))
    asked = station("prune", "--empty-bin")
    assert (
        asked.exit_code,
        "there is no terminal to ask in; --yes deletes 1 episode, 0.0 MB, for good" in asked.output,
    ) == (2, True)
    assert "1 episode, 0.0 MB, would be deleted" in station("prune", "--empty-bin", "--dry-run").output
    assert listed("--bin") == ["0001"]
    assert "1 episode, 0.0 MB, deleted" in station("prune", "--empty-bin", "--yes").output
    assert not (data / ".bin").exists()
    assert listed() == ["0002", "0003", "0004"]
    assert "nothing in" in station("prune", "--empty-bin", "--yes").output


def test_one_that_is_being_written_is_told_of_and_the_others_go(data: Path) -> None:
    with (data / "walk" / name(1) / "signals.mcap").open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        done = station("prune", name(1))
        assert (done.exit_code, done.stdout, "being written just now" in done.output) == (1, "", True)
        assert station("prune", "--task", "walk").exit_code == 1
    assert (listed(), listed("--bin")) == (["0001", "0004"], ["0002", "0003"])


def test_prune_without_a_word_of_what_moves_nothing(data: Path) -> None:
    done = station("prune")
    assert (done.exit_code, "name EPISODEs, or say which" in done.output) == (2, True)
    assert station("prune", "--empty-bin", "--task", "walk", "--yes").exit_code == 2
    assert station("prune", "--older-than", "soon").exit_code == 2
    assert station("prune", "nothing-of-the-kind").exit_code == 1
    assert len(listed()) == 4
