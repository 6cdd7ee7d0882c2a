"""What a check says of depth: faults of its bytes and of its times, that it sees nothing, and nothing of its shades."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from station import depth
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from tests.episode.depth_scenes import DEPTH, filmed, measured, steps
from tests.episode.scenes import CAMERA_HZ, HEAD, LENGTH_S, PICTURES, Shot, file_of, noise, sound

NOTHING = depth.encoded(np.zeros((60, 80), np.uint16))


def checked(data: Path, film: Callable[[Shot], bytes]) -> Quality:
    return check(open_episode(filmed(data, film)))


def said(quality: Quality) -> list[tuple[str, str]]:
    return [(reason.rule, reason.verdict) for reason in quality.reasons]


def test_of_sound_depth_nothing_is_said_and_how_much_was_measured_is_told(tmp_path: Path) -> None:
    quality = check(open_episode(filmed(tmp_path, colour=sound)))
    assert (quality.verdict, said(quality)) == ("good", [])
    (colour, found) = quality.pictures
    assert (colour.name, colour.depth) == ("head", None)
    assert (found.name, found.key, found.pictures, found.sizes) == ("head_depth", DEPTH, PICTURES, ["80x60"])
    assert found.depth is not None
    assert found.depth.measured_share == pytest.approx(76 / 80)
    assert (found.depth.blind.count, found.looked_at) == (0, 12)
    assert [(one.name, one.frames, one.nominal_hz) for one in quality.cameras] == [
        ("head", PICTURES, CAMERA_HZ), ("head_depth", PICTURES, CAMERA_HZ),
    ]  # fmt: skip


def test_depth_of_one_shade_is_not_judged_as_a_picture_in_colour_would_be(tmp_path: Path) -> None:
    """Black, blown out, of one colour, with jumps: a wall that comes and goes."""

    def wall(shot: Shot) -> bytes:
        nearest = 1 if shot.at_s < 3.0 else 60_000
        return depth.encoded(np.full((60, 80), nearest + shot.number, np.uint16))

    assert said(checked(tmp_path, wall)) == []


def frozen(shot: Shot) -> bytes:
    return depth.encoded(steps(30)) if shot.at_s >= 2.0 else measured(shot)


def twice(shot: Shot) -> bytes:
    return depth.encoded(steps(shot.number // 2))


def cut_off(shot: Shot) -> bytes:
    return measured(shot)[:-40] if shot.number % 10 == 4 else measured(shot)


def flipped(shot: Shot) -> bytes:
    """From 3 s on a bit within the pixels is wrong."""
    data = bytearray(measured(shot))
    data[len(data) // 2] ^= 1 if shot.at_s >= 3.0 else 0
    return bytes(data)


def smaller(shot: Shot) -> bytes:
    return depth.encoded(steps(shot.number)[::2, ::2]) if shot.at_s >= 3.0 else measured(shot)


def blind(from_s: float, to_s: float) -> Callable[[Shot], bytes]:
    """From one time to another no pixel has a depth; a text in the file tells its number, so that none repeats."""

    def film(shot: Shot) -> bytes:
        return numbered(shot.number) if from_s <= shot.at_s < to_s else measured(shot)

    return film


def numbered(number: int) -> bytes:
    body = b"tEXt" + b"n\0%04d" % number
    chunk = (len(body) - 4).to_bytes(4) + body + zlib.crc32(body).to_bytes(4)
    return NOTHING[:-12] + chunk + NOTHING[-12:]


@pytest.mark.parametrize(
    ("film", "expected", "told"),
    [
        (frozen, ("camera-frozen", "reject"), "the same picture from 2.00 s on"),
        (twice, ("camera-repeats", "usable"), "are the one before once more"),
        (cut_off, ("camera-torn", "reject"), "9 of 90 pictures (the first at 0.27 s) are no whole PNG file"),
        (flipped, ("camera-torn", "reject"), "45 of 90 pictures (the first at 3.00 s) are no whole PNG file"),
        (smaller, ("camera-resized", "reject"), "80x60 px at first, then 40x30: 45 of 90"),
        (blind(2.0, 4.1), ("camera-blind", "usable"), "sees nothing for 1.6 s from 2.13 s on"),
        (blind(0.0, LENGTH_S), ("camera-blind", "reject"), "sees nothing for 5.9 s from 0.00 s on"),
    ],
    ids=["frozen", "each twice", "torn", "a bit", "smaller", "blind for a while", "blind"],
)
def test_a_fault_is_told_by_camera_key_and_time(
    tmp_path: Path, film: Callable[[Shot], bytes], expected: tuple[str, str], told: str
) -> None:
    quality = checked(tmp_path, film)
    assert said(quality) == [expected]
    assert quality.reasons[0].text.startswith(f"camera head_depth ({DEPTH}): ")
    assert told in quality.reasons[0].text


def test_a_hand_before_the_camera_for_a_moment_is_no_fault(tmp_path: Path) -> None:
    quality = checked(tmp_path, blind(2.6, 2.9))
    assert said(quality) == []
    found = quality.pictures[0].depth
    assert found is not None
    assert (found.blind.count, found.blind_s, found.blind_at_s) == (1, 0.0, found.blind.first_s)
    assert 2.6 <= (found.blind.first_s or 0.0) < 2.9


def pausing(film: Callable[[Shot], bytes]) -> Callable[[Shot], bytes]:
    return lambda shot: b"" if 3.0 <= shot.at_s < 4.5 else film(shot)


def test_a_pause_of_a_camera_and_its_depth_is_told_once_and_one_of_depth_alone_as_such(tmp_path: Path) -> None:
    both = check(open_episode(filmed(tmp_path / "both", pausing(measured), colour=pausing(sound))))
    alone = check(open_episode(filmed(tmp_path / "alone", pausing(measured), colour=sound)))
    for quality, name in ((both, "head"), (alone, "head_depth")):
        told = [reason.text.split(":")[0] for reason in quality.reasons if reason.rule == "camera-gap"]
        assert told == [f"camera {name}"]
    assert [camera.missing for camera in both.cameras] == [23, 23], "the table has both"


def black(shot: Shot) -> bytes:
    return file_of(4.0 + noise(shot.number))


def test_a_camera_whose_picture_is_black_is_told_beside_sound_depth(tmp_path: Path) -> None:
    quality = check(open_episode(filmed(tmp_path, colour=black)))
    assert [(reason.rule, reason.text.split(":")[0]) for reason in quality.reasons] == [
        ("camera-black", f"camera head ({HEAD})")
    ]
