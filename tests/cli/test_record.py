"""``station record``: episodes by hand while a station runs."""

from __future__ import annotations

from pathlib import Path

from tests.cli.running import Home, one_line


def test_an_episode_by_hand(live: Home) -> None:
    done = live.run("record", "start", "--task", "By hand", "--instruction", "wave", "--operator", "ada")
    assert done.returncode == 0, done.stderr
    word, episode_id, path = done.stdout.split()
    assert word == "recording"
    assert "already recording" in one_line(live.run("record", "start"))
    assert live.run("record", "mark", "look here").stdout.startswith(f"marked {episode_id}")
    stopped = live.json("record", "stop", "--success")
    assert stopped["ok"]
    assert stopped["episode_id"] == episode_id
    assert stopped["summary"]["lost"] == stopped["summary"]["dropped"] == 0
    manifest = live.json("episodes", "show", path)["manifest"]
    assert Path(path).parent.name == "by-hand"
    assert (manifest["state"], manifest["operator"]["id"]) == ("finished", "ada")
    assert manifest["quality_flags"]["success"] is True
    assert "look here" in str(manifest["events"])


def test_discarding_marks_and_deletes_nothing(live: Home) -> None:
    path = live.json("record", "start", "--task", "bad")["path"]
    done = live.run("record", "discard", "--reason", "somebody walked in")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("discarded ")
    (row,) = live.json("episodes", "list", "--task", "bad")
    assert row["is_discarded"] is True
    assert (Path(path) / "signals.mcap").is_file()


def test_what_is_not_being_recorded_cannot_be_stopped_or_marked(live: Home) -> None:
    for verb in ("stop", "mark"):
        line = one_line(live.run("record", verb))
        assert line.startswith(
            f"record {verb}: nothing to {verb}: no episode is being recorded; `station record start`"
        )


def test_without_a_recorder_the_answer_comes_soon(bus_home: Home) -> None:
    line = one_line(bus_home.run("record", "start"))
    assert line == "record start: no recorder answered within 2 s; start one with `station serve recorder`"


def test_a_planned_time_is_a_duration_that_the_recorder_judges(live: Home) -> None:
    assert "--planned: expected a duration" in one_line(live.run("record", "start", "--planned", "long"))
    line = one_line(live.run("record", "start", "--planned", "800h"))
    assert line == "record start: not a record request: planned_s is 2880000.0, expected 0 to 2592000 seconds"
