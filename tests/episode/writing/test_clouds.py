"""Point clouds are in a file of their own, as viewers know them; who reads the episode gets the bytes of the bus."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.bus.tap import Position, Write
from station.episode.reading.reader import open_episode
from station.episode.storage import file_hashes
from station.episode.storage.bin import expect_at_rest
from station.episode.storage.manifest import save_manifest
from station.episode.storage.progress import load_resume_point
from station.episode.writing.repair import repair
from station.point_cloud import decoded as decoded_cloud
from tests.enrich.read_back import decoded
from tests.episode.filming import BODY, CLOUD, EXPOSED_NS, HEAD, Scene, film
from tests.episode.recorder.test_resume_cameras import go_on, killed

FILES = ["cameras.mcap", "clouds.mcap", "signals.mcap"]


def scenes(scene: Scene, count: int) -> list[list[Write]]:
    return [
        [*scene.signals(2), scene.cloud(), scene.picture(), *scene.signals(1), scene.picture(), scene.cloud()]
        for _ in range(count)
    ]


def values(batches: list[list[Write]], key: str) -> list[bytes | None]:
    return [write.value for batch in batches for write in batch if write.key == key]


def read(folder: Path, key: str) -> list[bytes]:
    return [message.data for message in open_episode(folder).messages([key])]


def test_a_cloud_is_a_foxglove_cloud_around_its_exact_bytes(tmp_path: Path) -> None:
    scene = Scene()
    batches = scenes(scene, 5)
    film(tmp_path / "e", batches, scene.anchor)
    assert [file.name for file in sorted((tmp_path / "e").glob("*.mcap"))] == FILES
    assert read(tmp_path / "e", CLOUD) == values(batches, CLOUD)
    found = decoded(tmp_path / "e" / "clouds.mcap", CLOUD)
    for one, value in zip(found, values(batches, CLOUD), strict=True):
        assert one.schema.name == "foxglove.PointCloud"
        assert one.message.data == decoded_cloud(value or b"").data
        taken_ns = one.message.timestamp.seconds * 10**9 + one.message.timestamp.nanos
        assert taken_ns == one.publish_ns - EXPOSED_NS


def test_what_is_no_cloud_is_recorded_all_the_same(tmp_path: Path) -> None:
    scene = Scene()
    batches = [[scene.cloud(b"no cloud at all"), scene.cloud()]]
    film(tmp_path / "e", batches, scene.anchor)
    assert read(tmp_path / "e", CLOUD) == values(batches, CLOUD)


def test_the_files_are_read_in_the_order_in_which_the_writes_came(tmp_path: Path) -> None:
    scene = Scene()
    at_ns = scene.anchor.mono_ns + 5_000_000
    sent = [write._replace(mono_ns=at_ns) for batch in scenes(scene, 4) for write in batch]
    film(tmp_path / "e", [sent], scene.anchor)
    found = [(message.topic, message.data) for message in open_episode(tmp_path / "e").messages()]
    assert found == [(write.key, write.value) for write in sent]
    by_time = [(message.topic, message.data) for message in open_episode(tmp_path / "e").messages(order="log")]
    assert by_time == found


def test_the_manifest_tells_the_file_of_clouds_from_another(tmp_path: Path) -> None:
    scene = Scene()
    folder = tmp_path / "e"
    film(folder, scenes(scene, 3), scene.anchor)
    before = file_hashes.measure(folder)
    assert [one.name for one in before] == ["signals.mcap", "cameras.mcap", "clouds.mcap"]
    (folder / "clouds.mcap").unlink()
    assert "clouds.mcap" in file_hashes.words(file_hashes.changes(before, file_hashes.measure(folder)))
    assert "clouds.mcap is not there, with 6 clouds that the manifest lists" in str(open_episode(folder).torn)
    assert len(read(folder, HEAD)) == 6
    expect_at_rest(folder, tmp_path)


@pytest.mark.usefixtures("processes")
def test_a_killed_recorder_goes_on_in_all_three_files(tmp_path: Path) -> None:
    scene, folder = Scene(), tmp_path / "walk" / "2026-11-21-g1-walk-0001"
    batches = scenes(scene, 4)
    killed(folder, scene, batches)
    point = load_resume_point(folder)
    assert point is not None
    assert point.clouds_size == (folder / "clouds.mcap.active").stat().st_size > 0
    assert point.position == Position("id", point.messages, 0)
    later = scenes(scene, 1)
    go_on(folder, later[0], is_exact=True)
    for key in (BODY, HEAD, CLOUD):
        assert read(folder, key) == values([*batches, *later], key)


def test_of_a_torn_file_of_clouds_what_is_whole_is_kept(tmp_path: Path) -> None:
    scene, folder = Scene(), tmp_path / "e"
    batches = scenes(scene, 4)
    manifest = film(folder, batches, scene.anchor)
    for name in FILES:
        (folder / name).rename(folder / f"{name}.active")
    manifest.state = "recording"
    save_manifest(manifest, folder)
    torn = folder / "clouds.mcap.active"
    torn.write_bytes(torn.read_bytes()[: torn.stat().st_size * 2 // 3])
    done = repair(folder)
    assert {cut.file for cut in done.cuts} == {"clouds.mcap"}
    kept = read(folder, CLOUD)
    assert 0 < len(kept) < 8
    assert kept == values(batches, CLOUD)[: len(kept)]
    assert read(folder, HEAD) == values(batches, HEAD)
    assert (folder / "clouds.mcap.torn").is_file()
