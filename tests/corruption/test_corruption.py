"""Recipes do what they say to the files, and nothing else: or the bench would judge checks by what never happened."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from tests.corruption import pictures
from tests.corruption.bench import Bench
from tests.corruption.files import CAMERAS, MANIFEST, SIGNALS, STAMPS, DoesNotFit, Episode
from tests.corruption.judging import Verdict, cell
from tests.corruption.parts import Harm, Robot
from tests.corruption.recipes import CONTROL, RECIPES, spoil
from tests.episode import depth_scenes
from tests.episode.compacting.two_files import in_two_files

OLD = Path(__file__).parents[1] / "episode/of_version_0_1/episodes"
WALK, LOOK, ARM = (OLD / f"2026-11-22-{name}-0001" for name in ("g1-walk", "g1-look", "kassow-kr810-jog"))


@pytest.fixture
def copied(tmp_path: Path):
    """Copies an episode into a folder of the test."""

    def copy(folder: Path, name: str = "copy") -> Path:
        made = tmp_path / name / folder.name
        shutil.copytree(folder, made)
        return made

    return copy


def contents(path: Path) -> list[tuple[Any, ...]]:
    """Return all messages of a file as the library reads them: topic, metadata, sequence, times, data."""
    with path.open("rb") as file:
        return [
            (channel.topic, str(channel.metadata), one.sequence, one.log_time, one.publish_time, one.data)
            for _, channel, one in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        ]


def of_topic(path: Path, topic: str) -> list[tuple[Any, ...]]:
    return [one for one in contents(path) if one[0] == topic]


def others(path: Path, *topics: str) -> list[tuple[Any, ...]]:
    return [one for one in contents(path) if one[0] not in (*topics, STAMPS)]


def rows(folder: Path) -> dict[str, dict[str, Any]]:
    return {row["key"]: row for row in yaml.safe_load((folder / MANIFEST).read_text())["streams"]}


def everything(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("folder", [WALK, LOOK, ARM], ids=lambda folder: folder.name)
def test_an_episode_that_is_taken_apart_and_put_together_again_holds_the_same(folder: Path, copied) -> None:
    copy = copied(folder)
    spoil(CONTROL.name, copy, folder)
    for path in folder.glob("*.mcap"):
        assert contents(copy / path.name) == contents(path)
        with path.open("rb") as one, (copy / path.name).open("rb") as two:
            readers = [make_reader(one), make_reader(two)]
            before, after = [[(each.name, each.metadata) for each in reader.iter_metadata()] for reader in readers]
            assert before == after
            before, after = [[yaml.safe_load(each.data) for each in reader.iter_attachments()] for reader in readers]
            assert before == after
    before, after = [yaml.safe_load((each / MANIFEST).read_text()) for each in (folder, copy)]
    size = after["recorder"].pop("bytes"), before["recorder"].pop("bytes")
    assert before == after
    assert size[0] in (size[1], (copy / SIGNALS).stat().st_size)


def test_there_are_many_kinds_of_many_groups() -> None:
    assert len(RECIPES) >= 60
    assert {made.group for made in RECIPES.values()} == {
        "presence", "losses", "times", "pictures", "states", "commands", "manifest", "files",
    }  # fmt: skip
    assert all(made.what.endswith(".") and "\n" not in made.what for made in RECIPES.values())


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("robot-ends-at-half", ARM),
        ("state-reordered", ARM),
        ("clock-of-the-robot-drifts", ARM),
        ("state-of-another-episode-spliced-in", WALK),
        ("policy-actions-scaled", WALK),
        ("success-flipped", WALK),
        ("signals-with-a-tail", ARM),
        ("manifest-among-the-signals-gone", WALK),
    ],
)
def test_a_recipe_changes_the_episode(name: str, folder: Path, copied) -> None:
    copy = copied(folder)
    assert spoil(name, copy, LOOK).names
    assert [each for each, data in everything(copy).items() if data != (folder / each).read_bytes()]


def test_a_black_camera_is_black_and_nothing_else_is_changed(copied) -> None:
    copy = copied(LOOK)
    harm = spoil("black", copy, LOOK)
    spoiled = pictures.cameras(Episode(copy))[0]
    assert spoiled.key in harm.names
    assert max(int(pictures.decoded(message).max()) for message in spoiled.messages) == 0
    assert others(copy / CAMERAS, spoiled.key) == others(LOOK / CAMERAS, spoiled.key)
    assert others(copy / SIGNALS) == others(LOOK / SIGNALS)


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("depth-frozen", "camera-frozen"),
        ("depth-all-zero-from-half-on", "camera-blind"),
        ("tenth-of-the-depth-cut-off", "camera-torn"),
    ],
)
def test_spoiled_depth_is_told_by_its_key_and_nothing_else_is_changed(
    name: str, rule: str, copied, tmp_path: Path
) -> None:
    sound = in_two_files(depth_scenes.filmed(tmp_path / "made"), tmp_path / "sound")
    copy = copied(sound)
    assert depth_scenes.DEPTH in spoil(name, copy, sound).names
    assert others(copy / SIGNALS) == others(sound / SIGNALS)
    told = {reason.rule: reason.text for reason in check(open_episode(copy)).reasons}
    assert depth_scenes.DEPTH in told[rule]
    assert rule not in {reason.rule for reason in check(open_episode(sound)).reasons}


def test_deleted_states_are_gone_with_their_stamps_and_the_manifest_counts_what_is_left(copied) -> None:
    copy = copied(WALK)
    (key,) = spoil("state-5-percent-deleted-renumbered", copy, WALK).names
    before, after = of_topic(WALK / SIGNALS, key), of_topic(copy / SIGNALS, key)
    assert len(after) == len(before) - round(0.05 * len(before))
    assert [one[2] for one in after] == list(range(before[0][2], before[0][2] + len(after)))
    assert {one[5] for one in after} < {one[5] for one in before}
    stamps = [one[5].count(b"\n") + 1 for one in of_topic(copy / SIGNALS, STAMPS)]
    assert sum(stamps) == len(others(copy / SIGNALS))
    assert rows(copy)[key]["count"] == len(after)
    assert rows(copy)[key]["lost"] == 0


def test_a_deleted_state_that_is_not_renumbered_is_counted_as_lost(copied) -> None:
    copy = copied(WALK)
    (key,) = spoil("state-one-deleted", copy, WALK).names
    assert rows(copy)[key]["lost"] == 1


def test_a_joint_that_is_off_is_off_in_every_state_and_alone(copied) -> None:
    copy = copied(WALK)
    names = spoil("one-joint-off-by-half-a-radian", copy, WALK).names
    for before, after in zip(Robot(Episode(WALK)).states, Robot(Episode(copy)).states, strict=True):
        change = after.values - before.values
        for index, name in enumerate(before.names):
            np.testing.assert_allclose(
                change[:, index], 0.5 if name in names and name.endswith("_pos") else 0.0, atol=1e-9
            )


def test_moved_times_are_moved_in_message_and_stamp(copied) -> None:
    copy = copied(WALK)
    (key,) = spoil("state-stamped-100-ms-early", copy, WALK).names
    for before, after in zip(Robot(Episode(WALK)).state.messages, Robot(Episode(copy)).state.messages, strict=True):
        assert after.publish_ns - before.publish_ns == -100_000_000
        assert after.log_ns == before.log_ns
        fields = [[int(word) for word in (one.stamp or b"").split(b" ")[:3]] for one in (before, after)]
        assert [two - one for one, two in zip(*fields, strict=True)] == [0, -100_000_000, -100_000_000]
    assert others(copy / SIGNALS, key) == others(WALK / SIGNALS, key)


def test_a_hand_on_the_manifest_changes_one_word_of_it(copied) -> None:
    copy = copied(WALK)
    spoil("task-changed", copy, WALK)
    before, after = (WALK / MANIFEST).read_text(), (copy / MANIFEST).read_text()
    assert after == before.replace("task: {name: walk,", "task: {name: fold,", 1) != before
    assert (copy / SIGNALS).read_bytes() == (WALK / SIGNALS).read_bytes()


def test_a_flipped_byte_is_one_bit(copied) -> None:
    copy = copied(WALK)
    spoil("one-byte-of-the-signals-flipped", copy, WALK)
    before, after = [np.frombuffer((each / SIGNALS).read_bytes(), np.uint8) for each in (WALK, copy)]
    assert int(np.unpackbits(before ^ after).sum()) == 1


def test_a_camera_that_is_gone_leaves_no_channel_behind(copied) -> None:
    copy = copied(LOOK)
    try:
        harm = spoil("camera-without-a-picture", copy, LOOK)
    except DoesNotFit:
        pytest.skip("the old episode has one camera")
    assert not set(harm.names) & set(rows(copy))


BEFORE = Verdict("usable", [{"rule": "idle-ends", "verdict": "usable", "text": "nothing moves in the last 11.2 s"}])
HARM = Harm(("state_of_it",), 4.0, 7.0)


def told(text: str, rule: str = "gap", verdict: str = "usable") -> Verdict:
    return Verdict(verdict, [*BEFORE.reasons, {"rule": rule, "verdict": verdict, "text": text}], length_s=10.0)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (BEFORE, "missed"),
        (told("nothing moves in the last 12.9 s", "idle-ends"), "missed"),
        (told("something is odd"), "told"),
        (told("state_of_it repeats itself"), "key"),
        (told("other_state_of_it repeats itself from 4.1 s"), "told"),
        (told("state_of_it repeats itself for 3.0 s from 4.1 s on"), "full"),
        (told("state_of_it stands from 3.9 to 6.0 s"), "full"),
        (told("state_of_it stood still for 4 s"), "key"),
        (told("state_of_it: nothing in the last 6.1 s"), "full"),
        (Verdict("reject", BEFORE.reasons), "told"),
    ],
)
def test_a_catch_counts_by_what_its_reason_names(found: Verdict, expected: str) -> None:
    assert cell(found, BEFORE, HARM) == expected


def test_a_run_that_was_interrupted_goes_on(tmp_path: Path) -> None:
    bench = Bench(tmp_path, {"walk": (WALK, WALK)})
    bench._file.write_text('{"trial": "a", "verdict": "good"}\n{"trial": "b", "ver')
    assert list(Bench(tmp_path, {"walk": (WALK, WALK)})._kept) == ["a"]
