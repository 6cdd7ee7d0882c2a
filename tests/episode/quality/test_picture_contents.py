"""What a check says of pictures: each fault by camera, key and time, and nothing of sound ones."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.episode.quality import picture_contents, rule_file
from station.episode.quality.check import check, write_measured
from station.episode.quality.finding_parts import PictureQuality, Seen
from station.episode.quality.findings import Quality
from station.episode.quality.standing import stands
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import save_manifest
from station.protocols import Floats
from tests.episode.scenes import (
    CAMERA_HZ,
    HEAD,
    LENGTH_S,
    PICTURES,
    STATE_HZ,
    WRIST,
    Film,
    Shot,
    file_of,
    filmed,
    noise,
    noisy,
    scene,
    sound,
)
from tests.episode.synthetic import STANDING, EpisodeBuilder, tick


def checked(data: Path, film: Film, **options: Any) -> Quality:
    return check(open_episode(filmed(data, film, **options)))


def said(quality: Quality) -> list[tuple[str, str]]:
    return [(reason.rule, reason.verdict) for reason in quality.reasons]


def head(quality: Quality) -> PictureQuality:
    return quality.pictures[0]


def still(_: Shot) -> bytes:
    return noisy(0)


def cut_off(shot: Shot) -> bytes:
    """One file in ten ends before its end."""
    return sound(shot)[:-700] if shot.number % 10 == 4 else sound(shot)


def without_a_head(shot: Shot) -> bytes:
    return sound(shot)[2:] if shot.number == 30 else sound(shot)


def broken_within(shot: Shot) -> bytes:
    """From 2 s on every file is whole by its ends, and spoilt between them."""
    data = bytearray(sound(shot))
    if shot.at_s >= 2.0:
        half = len(data) // 2
        data[half : half + 300] = bytes(300)
    return bytes(data)


def smaller(shot: Shot) -> bytes:
    return file_of(scene(shot.number)[::2, ::2]) if shot.at_s >= 3.0 else sound(shot)


def frozen_for(from_s: float, to_s: float) -> Film:
    def film(shot: Shot) -> bytes:
        return noisy(round(from_s * CAMERA_HZ)) if from_s <= shot.at_s < to_s else sound(shot)

    return film


def frozen_in_other_bytes(shot: Shot) -> bytes:
    """From 2 s on one picture, with a comment in it that tells the time."""
    if shot.at_s < 2.0:
        return sound(shot)
    data, comment = noisy(30), b"%08d" % shot.number
    return data[:2] + b"\xff\xfe" + (len(comment) + 2).to_bytes(2, "big") + comment + data[2:]


def twice(shot: Shot) -> bytes:
    return noisy(shot.number // 2)


def black_for(from_s: float, to_s: float = LENGTH_S) -> Film:
    def film(shot: Shot) -> bytes:
        is_black = from_s <= shot.at_s < to_s
        return file_of(4.0 + noise(shot.number)) if is_black else sound(shot)

    return film


def blown_out(shot: Shot) -> bytes:
    return file_of(scene(shot.number) * 4.0 + noise(shot.number)) if shot.at_s >= 2.0 else sound(shot)


def one_colour(shot: Shot) -> bytes:
    return file_of(np.full((240, 320), 120.0 + shot.number % 3)) if shot.at_s >= 4.0 else sound(shot)


def hunting(shot: Shot) -> bytes:
    """An exposure that jumps each second, of a scene that hardly changes."""
    return noisy(shot.number, moves=False, gain=1.0 if int(shot.at_s) % 2 else 0.55)


@pytest.mark.parametrize(
    ("film", "expected", "told"),
    [
        (cut_off, ("camera-torn", "reject"), "9 of 90 pictures (the first at 0.27 s) are no whole JPEG file"),
        (without_a_head, ("camera-torn", "reject"), "1 of 90 pictures (the first at 2.00 s) are no whole JPEG file"),
        (broken_within, ("camera-torn", "reject"), "(the first at 2.13 s) looked at cannot be decoded"),
        (smaller, ("camera-resized", "reject"), "px at first, then 160x120: 45 of 90 pictures (the first at 3.00 s)"),
        (frozen_for(1.0, 5.0), ("camera-frozen", "reject"), "from 1.00 s on, while joints moved for 3."),
        (frozen_for(2.0, 3.4), ("camera-frozen", "usable"), "from 2.00 s on, while joints moved for 1."),
        (frozen_for(4.0, 9.0), ("camera-frozen", "usable"), "from 4.00 s on, while joints moved for 1."),
        (frozen_in_other_bytes, ("camera-frozen", "reject"), "from 2.1"),
        (twice, ("camera-repeats", "usable"), "taken while joints moved are the one before once more"),
        (black_for(3.0), ("camera-black", "reject"), "(the first at 3.20 s) looked at are black"),
        (black_for(2.0, 3.0), ("camera-black", "usable"), "looked at are black"),
        (blown_out, ("camera-saturated", "usable"), "looked at are blown out"),
        (one_colour, ("camera-flat", "usable"), "looked at show one colour"),
        (hunting, ("camera-exposure", "usable"), "looked at are the one before in another brightness"),
    ],
)  # fmt: skip
def test_each_fault_is_told_of_its_camera_with_key_time_and_amount(
    tmp_path: Path, film: Film, expected: tuple[str, str], told: str
) -> None:
    quality = checked(tmp_path, film)
    assert said(quality) == [expected]
    assert quality.reasons[0].text.startswith(f"camera head ({HEAD}): ")
    assert told in quality.reasons[0].text


def dim(shot: Shot) -> bytes:
    """A dark room with a lamp: a mean grey of about 10."""
    return file_of(scene(shot.number) * 0.06 + noise(shot.number) * 0.5 + 60.0 * (scene(shot.number) > 225))


def in_grey_mist(shot: Shot) -> bytes:
    return file_of(110.0 + 0.1 * scene(shot.number) + noise(shot.number), quality=60)


def padded(shot: Shot) -> bytes:
    return sound(shot) + bytes(512)


def turning(shot: Shot) -> bytes:
    """A camera that turns from a window to a dark corner each second."""
    grey = scene(shot.number) * 1.2 if int(shot.at_s) % 2 else scene(shot.number)[::-1, ::-1] * 0.4
    return file_of(grey + noise(shot.number))


def covered_for_a_moment(shot: Shot) -> bytes:
    return file_of(noise(0) + 3.0) if 2.5 < shot.at_s < 2.8 else sound(shot)


def tiny(shot: Shot) -> bytes:
    return file_of((scene(shot.number) + noise(shot.number))[::30, ::20])  # 16x8


def rendered(shot: Shot) -> bytes:
    return file_of(scene(shot.number))  # without noise


@pytest.mark.parametrize(
    ("film", "moves"),
    [
        (sound, True), (dim, True), (in_grey_mist, True), (padded, True), (turning, True),
        (covered_for_a_moment, True), (rendered, True), (tiny, True),
        (lambda shot: noisy(shot.number, moves=False), False),  # nothing moves before a real camera
        (still, False),  # nor before a simulated one, whose bytes are the same
        (lambda shot: noisy(shot.number, moves=False), True),  # the arm moves out of sight
    ],
)  # fmt: skip
def test_nothing_is_said_of_sound_pictures(tmp_path: Path, film: Film, moves: bool) -> None:
    quality = checked(tmp_path, film, moves=moves)
    assert said(quality) == []
    assert head(quality).pictures == PICTURES
    assert head(quality).looked_at >= 11, "two a second"


def test_a_simulated_camera_that_stood_still_until_the_robot_moved_is_sound(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number in range(300):
        at_s, q = number / STATE_HZ, STANDING.copy()
        moved_s = max(0.0, at_s - 4.0)
        q[18] += 0.4 * (1.0 - np.cos(2.0 * moved_s))
        tick(builder, number, at_s=at_s, q=q)
        if number % 5 == 0:
            builder.write({HEAD: file_of(scene(round(20.0 * moved_s)))}, at_s=at_s, writer="head")
    found = check(open_episode(builder.finish({"servers": {"head": {"key": HEAD, "fps": 10}}})))
    assert said(found) == []
    assert 3.9 <= head(found).still_s <= 4.2
    assert head(found).frozen_s < 0.5


@pytest.mark.parametrize(("grey", "rule"), [(0.0, "camera-black"), (255.0, "camera-saturated"), (90.0, "camera-flat")])
def test_a_picture_of_one_grey_has_one_name_and_is_frozen(tmp_path: Path, grey: float, rule: str) -> None:
    quality = checked(tmp_path, lambda _: file_of(np.full((240, 320), grey)))
    assert {name for name, _ in said(quality)} == {"camera-frozen", rule}


def test_only_the_camera_that_is_ill_is_named(tmp_path: Path) -> None:
    quality = checked(tmp_path, sound, wrist=black_for(0.0))
    assert said(quality) == [("camera-black", "reject")]
    assert quality.reasons[0].text.startswith(f"camera wrist ({WRIST}): ")
    assert [(one.name, one.black.count > 0) for one in quality.pictures] == [("head", False), ("wrist", True)]


def test_one_picture_of_many_that_cannot_be_decoded_leaves_the_episode_usable(tmp_path: Path) -> None:
    def film(shot: Shot) -> bytes:
        data = bytearray(sound(shot))
        if shot.number == 0:  # which is looked at
            data[2000:2300] = bytes(300)
        return bytes(data)

    limits = tmp_path / "rules.yaml"
    limits.write_text("camera-torn: {reject_above_share: 0.02}")  # 1 of 90 is more than the 1 % that ship
    quality = check(open_episode(filmed(tmp_path, film)), rule_file.load(limits))
    assert said(quality) == [("camera-torn", "usable")]


def test_padding_between_segments_is_no_damage(tmp_path: Path) -> None:
    def film(shot: Shot) -> bytes:
        data = sound(shot)
        return data[:-2] + bytes(5) + data[-2:]

    assert said(checked(tmp_path, film)) == []


def test_numbers_of_brightness_and_sharpness_follow_the_picture(tmp_path: Path) -> None:
    soft = head(checked(tmp_path / "soft", lambda shot: file_of(np.tile(np.linspace(60, 190, 320), (240, 1)))))
    sharp = head(checked(tmp_path / "sharp", rendered))
    assert soft.sharpness is not None
    assert sharp.sharpness is not None
    assert soft.sharpness < 0.5 * sharp.sharpness
    assert soft.brightness == pytest.approx(125.0, abs=3.0)


def test_a_lab_may_ask_for_sharp_pictures_of_its_camera(tmp_path: Path) -> None:
    rules = tmp_path / "rules.yaml"
    rules.write_text("camera-blurred: {verdict: usable, below: 1.0e+6}")
    quality = check(open_episode(filmed(tmp_path, rendered)), rule_file.load(rules))
    assert said(quality) == [("camera-blurred", "usable")]
    assert "expected 1e+06 and more" in quality.reasons[0].text


@pytest.mark.parametrize("film", [sound, black_for(3.0), cut_off, blown_out, frozen_in_other_bytes])
def test_pillow_finds_the_same_where_the_extra_is_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, film: Film
) -> None:
    with_extra = checked(tmp_path / "with", film)
    monkeypatch.setitem(sys.modules, "simplejpeg", None)
    without = checked(tmp_path / "without", film)
    assert (head(with_extra).decoder, head(without).decoder) == ("simplejpeg", "pillow")
    assert said(without) == said(with_extra)


def test_a_verdict_that_was_written_before_pictures_were_looked_at_does_not_stand(tmp_path: Path) -> None:
    folder = filmed(tmp_path, sound)
    manifest = write_measured(folder, check(open_episode(folder)))
    kept = stands(open_episode(folder))
    assert kept is not None
    assert kept.pictures[0].torn == Seen()
    del manifest.quality["pictures"]
    save_manifest(manifest, folder)
    assert stands(open_episode(folder)) is None


def test_an_episode_without_cameras_starts_no_thread(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number in range(100):
        tick(builder, number, at_s=number / STATE_HZ)
    assert check(open_episode(builder.finish())).pictures == []


def test_of_a_long_episode_fewer_pictures_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_contents, "_MOST_SAMPLES", 4)
    assert head(checked(tmp_path, sound)).looked_at == 4


CHANCE = np.random.default_rng(7)


def from_half_on(spoil: Callable[[Floats], Floats]) -> Film:
    """A sound camera until 3 s, of which the pictures are then spoilt."""

    def film(shot: Shot) -> bytes:
        grey = scene(shot.number // 8) + noise(shot.number)  # it hardly moves
        return file_of(spoil(grey) if shot.at_s >= 3.0 else grey)

    return film


def blurred(grey: Floats) -> Floats:
    """Out of focus: means over 40 pixels, twice."""
    kernel = np.ones(40) / 40
    for axis in (0, 1, 0, 1):
        grey = np.apply_along_axis(
            lambda line: np.convolve(np.pad(line, 20, mode="edge"), kernel, "valid")[1:], axis, grey
        )
    return grey


def cut(grey: Floats) -> Floats:
    return np.concatenate([grey[:120], np.full_like(grey[120:], 128.0)])


@pytest.mark.parametrize(
    ("spoil", "expected", "told"),
    [
        (lambda grey: CHANCE.uniform(0, 255, grey.shape), ("camera-noise", "reject"), "first at 3."),
        (cut, ("camera-cut", "usable"), "(the first at 3."),
        (lambda grey: grey[::-1, ::-1], ("camera-turned", "usable"), "turned upside down at 3."),
        (blurred, ("camera-blurred", "usable"), "its focus went at 3."),
    ],
    ids=["noise", "cut", "turned", "blurred"],
)  # fmt: skip
def test_what_a_camera_shows_from_half_on_is_told_with_when(
    tmp_path: Path, spoil: Callable[[Floats], Floats], expected: tuple[str, str], told: str
) -> None:
    quality = checked(tmp_path, from_half_on(spoil))
    assert said(quality) == [expected]
    assert told in quality.reasons[0].text


def test_a_blur_of_a_moment_is_a_fast_motion(tmp_path: Path) -> None:
    def film(shot: Shot) -> bytes:
        return file_of(
            blurred(scene(0) + noise(shot.number)) if 2.9 < shot.at_s < 3.3 else scene(0) + noise(shot.number)
        )

    assert said(checked(tmp_path, film, moves=False)) == []


def test_cameras_that_change_names_in_the_middle_are_told_of_both(tmp_path: Path) -> None:
    def seen(shot: Shot, *, is_first: bool) -> bytes:
        other = np.tile(np.linspace(190.0, 60.0, 240)[:, None], (1, 320))
        return file_of((scene(shot.number // 8) if is_first is (shot.at_s < 3.0) else other) + noise(shot.number))

    quality = checked(tmp_path, lambda shot: seen(shot, is_first=True), wrist=lambda shot: seen(shot, is_first=False))
    assert said(quality) == [("cameras-swapped", "usable")] * 2
    assert "shows from then on, at 3." in quality.reasons[0].text
    assert quality.reasons[0].text.endswith("what wrist showed before")
