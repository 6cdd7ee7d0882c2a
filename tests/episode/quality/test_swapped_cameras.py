"""Two cameras that changed places since the first episode of a task are told, and others are not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from station.episode.quality.check import check, write_measured
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from station.episode.storage.layout import MANIFEST
from tests.episode.scenes import CAMERA_HZ, HEAD, WRIST, Film, Shot, file_of, filmed, noise, scene, sound

FIRST = "2026-11-21-g1-walk-0001"


def of_the_wrist(shot: Shot) -> bytes:
    """Another view: a table with a cup on it."""
    grey = scene(shot.number).T[:, :240].repeat(2, axis=1)[:240, :320] * 0.5
    grey[150:] = 200.0
    return file_of(grey + noise(shot.number))


def servers(head: str, wrist: str) -> dict[str, Any]:
    """Cameras with the serial numbers of their devices."""
    return {
        "head": {"role": "sensor", "key": HEAD, "camera": "head", "fps": CAMERA_HZ, "serial": head},
        "wrist": {"role": "sensor", "key": WRIST, "camera": "wrist", "fps": CAMERA_HZ, "serial": wrist},
    }


def record(data: Path, number: int, head: Film, wrist: Film, **manifest: Any) -> Quality:
    """Record an episode with two cameras and check it, as `station check` does."""
    folder = filmed(data, head, wrist=wrist, number=number, length_s=2.0, **manifest)
    quality = check(open_episode(folder))
    write_measured(folder, quality)
    return quality


def reasons(quality: Quality) -> list[tuple[str, str, str]]:
    return [(reason.rule, reason.verdict, reason.text) for reason in quality.reasons]


def test_devices_that_changed_names_are_told_by_their_serial_numbers_in_each_later_episode(tmp_path: Path) -> None:
    assert reasons(record(tmp_path, 1, sound, sound, servers=servers("A1", "B2"))) == []
    for number in (2, 3):
        told = reasons(record(tmp_path, number, sound, sound, servers=servers("B2", "A1")))
        text = "head is the one that was wrist, wrist is the one that was head"
        assert told == [
            ("cameras-swapped", "usable", f"cameras changed places since {FIRST}, by serial numbers: {text}")
        ]


@pytest.mark.parametrize(
    ("before", "now"),
    [
        (("A1", "B2"), ("A1", "B2")),
        (("A1", "B2"), ("C3", "B2")),  # one was replaced
        (("A1", "B2"), ("C3", "D4")),
        (("", ""), ("A1", "B2")),
        (("A1", "A1"), ("A1", "A1")),  # cheap cameras share a number
        (("A1", "A1"), ("B2", "A1")),
        (("A1", "B2"), ("B2", "B2")),
    ],
)
def test_other_devices_are_no_swap(tmp_path: Path, before: tuple[str, str], now: tuple[str, str]) -> None:
    record(tmp_path, 1, sound, of_the_wrist, servers=servers(*before))
    assert reasons(record(tmp_path, 2, sound, of_the_wrist, servers=servers(*now))) == []


def test_views_that_changed_names_are_told_where_there_are_no_serial_numbers(tmp_path: Path) -> None:
    assert reasons(record(tmp_path, 1, sound, of_the_wrist)) == []
    assert reasons(record(tmp_path, 2, sound, of_the_wrist)) == []
    quality = record(tmp_path, 3, of_the_wrist, sound)
    assert [(rule, verdict) for rule, verdict, _ in reasons(quality)] == [("cameras-swapped", "usable")]
    assert f"since {FIRST}, by what they see: head is the one that was wrist" in quality.reasons[0].text


def test_serial_numbers_have_the_last_word(tmp_path: Path) -> None:
    record(tmp_path, 1, sound, of_the_wrist, servers=servers("A1", "B2"))
    assert reasons(record(tmp_path, 2, of_the_wrist, sound, servers=servers("A1", "B2"))) == []


@pytest.mark.parametrize(
    ("head", "wrist"),
    [
        (of_the_wrist, of_the_wrist),
        (sound, sound),
        (
            lambda shot: file_of(scene(shot.number)[:, ::-1] + noise(shot.number)),
            of_the_wrist,
        ),  # the room was turned round
        (of_the_wrist, lambda shot: file_of(scene(shot.number)[:, ::-1] + noise(shot.number))),
    ],
)
def test_views_that_changed_are_no_swap(tmp_path: Path, head: Film, wrist: Film) -> None:
    record(tmp_path, 1, sound, of_the_wrist)
    assert reasons(record(tmp_path, 2, head, wrist)) == []


def test_two_views_that_are_alike_are_no_swap(tmp_path: Path) -> None:
    record(tmp_path, 1, sound, lambda shot: file_of(scene(shot.number + 3) * 0.9))
    assert reasons(record(tmp_path, 2, lambda shot: file_of(scene(shot.number + 3) * 0.9), sound)) == []


def test_the_cameras_of_another_task_or_of_a_broken_manifest_say_nothing(tmp_path: Path) -> None:
    record(tmp_path, 1, sound, of_the_wrist, task={"name": "other"})
    record(tmp_path, 2, sound, of_the_wrist)
    (tmp_path / "walk" / "2026-11-21-g1-walk-0002" / MANIFEST).write_text("quality: [")
    assert reasons(record(tmp_path, 3, of_the_wrist, sound)) == []
