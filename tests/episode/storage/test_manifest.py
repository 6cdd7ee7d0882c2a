from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from station.episode.storage.anchor import Anchor
from station.episode.storage.manifest import (
    Event,
    Manifest,
    Robot,
    Stream,
    Task,
    Timing,
    load_manifest,
    save_manifest,
    snapshot,
)
from station.errors import EpisodeError


def full_manifest() -> Manifest:
    return Manifest(
        episode_id="2026-11-21-g1-walk-0007",
        task=Task(name="walk", instruction="geh zur Tür – langsam"),
        robot=Robot(suffix="g1", facts={"kp": [100.0, 1e-05], "model": None}),
        timing=Timing(
            started="2026-11-21T10:00:00.000+01:00", anchor=Anchor(1_795_000_000_000_000_001, 77, "abcd1234")
        ),
        streams=[Stream(key="action_mimic_g1", count=3, rate_hz=50.0)],
        events=[Event(at_s=1.5, name="fall", numbers={"tilt_rad": 1.2})],
    )


def test_a_saved_manifest_reads_back_equal(tmp_path: Path) -> None:
    save_manifest(full_manifest(), tmp_path)
    assert load_manifest(tmp_path) == full_manifest()
    assert [file.name for file in tmp_path.iterdir()] == ["manifest.yaml"]


def test_the_blueprint_s_field_names_stand_at_the_top(tmp_path: Path) -> None:
    document = yaml.safe_load(save_manifest(full_manifest(), tmp_path))
    assert {"episode_id", "task", "operator", "robot", "policy", "streams", "timing", "quality_flags"} <= set(document)


def test_keys_of_other_tools_survive_reading_and_writing(tmp_path: Path) -> None:
    file = tmp_path / "manifest.yaml"
    document = yaml.safe_load(save_manifest(full_manifest(), tmp_path))
    document["lab_notes"] = {"room": 3}
    document["timing"]["ptp_offset"] = 0.25
    file.write_text(yaml.safe_dump(document))
    manifest = load_manifest(tmp_path)
    manifest.quality_flags.discarded = True
    save_manifest(manifest, tmp_path)
    again = yaml.safe_load(file.read_text())
    assert again["lab_notes"] == {"room": 3}
    assert again["timing"]["ptp_offset"] == 0.25
    assert again["quality_flags"]["discarded"] is True
    assert "foreign" not in again


def test_a_misspelt_field_cannot_be_written() -> None:
    with pytest.raises(TypeError, match="sucess"):
        Manifest(sucess=True)  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1, 2]", "expected a mapping"),
        ("a: [", "not YAML"),
        ("task: 3", r"task"),
        ("quality_flags: {falls: many}", r"quality_flags\.falls"),
        ("!!python/object/apply:os.system ['true']", "not YAML"),
        ("manifest_version: 2", "of version 2, by a later station; this one reads up to version 1: upgrade it"),
    ],
)
def test_a_bad_manifest_is_refused_in_one_line_that_names_the_place(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "manifest.yaml").write_text(text)
    with pytest.raises(EpisodeError, match=words) as caught:
        load_manifest(tmp_path)
    assert "manifest.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_manifest_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match=r"manifest\.yaml.*No such file"):
        load_manifest(tmp_path)


def test_a_failed_save_leaves_the_old_manifest_and_nothing_beside_it(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="cannot write"):
        save_manifest(full_manifest(), tmp_path / "gone")
    assert not (tmp_path / "gone").exists()
    assert list(tmp_path.iterdir()) == []


def test_a_snapshot_does_not_follow_the_original() -> None:
    manifest = full_manifest()
    copied = snapshot(manifest)
    manifest.events.clear()
    manifest.robot.facts["kp"].append(1.0)
    assert copied == full_manifest()
