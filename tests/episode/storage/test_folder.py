from __future__ import annotations

import re
import threading
import time
from pathlib import Path

import pytest
from mcap.writer import Writer

from station.episode.storage.folder import data_folder, find_episodes, new_folder, resolve, signals_file, slug
from station.errors import EpisodeError


def make(data: Path, task: str, episode_id: str, *, age_s: float = 0.0) -> Path:
    folder = data / task / episode_id
    folder.mkdir(parents=True)
    with (folder / "signals.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("teleop-station")
        writer.add_metadata("station.anchor", {"wall_ns": str(time.time_ns() - int(age_s * 1e9))})
        writer.finish()
    return folder


def test_an_id_tells_date_robot_task_and_the_next_free_number(tmp_path: Path) -> None:
    first = new_folder(tmp_path, "Cabinet / left", "G1")
    assert first.parent == tmp_path / "cabinet-left"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d-g1-cabinet-left-0001", first.name)
    make(tmp_path, "cabinet-left", "2020-01-01-kassow-cabinet-left-0041")
    (tmp_path / "cabinet-left" / "notes-9999").mkdir()
    assert new_folder(tmp_path, "Cabinet / left", "g1").name.endswith("-0042")


def test_a_task_s_name_never_leaves_the_data_folder(tmp_path: Path) -> None:
    folder = new_folder(tmp_path, "../../etc/passwd", "")
    assert folder.parent.parent == tmp_path
    assert slug("") == slug("///") == "untitled"
    assert (slug("日本語 テスト"), slug("Größe_2"), slug("../ÉTÉ")) == ("日本語-テスト", "größe-2", "été")
    assert len(slug("x" * 500)) < 60


def test_recorders_that_start_together_get_different_numbers(tmp_path: Path) -> None:
    found: list[Path] = []
    threads = [threading.Thread(target=lambda: found.append(new_folder(tmp_path, "walk", "g1"))) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(folder.name[-4:] for folder in found) == [f"{n:04d}" for n in range(1, 17)]


def test_a_data_folder_that_is_a_file_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("")
    with pytest.raises(EpisodeError, match=r"cannot make an episode.*--data"):
        new_folder(tmp_path / "data", "walk", "g1")


def test_episodes_are_found_by_path_id_beginning_and_latest(tmp_path: Path) -> None:
    old = make(tmp_path, "walk", "2026-11-20-g1-walk-0001", age_s=90_000)
    newer = make(tmp_path, "squat", "2026-11-21-g1-squat-0001", age_s=10)
    newest = make(tmp_path, "walk", "2026-11-21-g1-walk-0002", age_s=5)
    (tmp_path / "walk" / "empty").mkdir()
    assert find_episodes(tmp_path) == [old, newer, newest]
    assert resolve(old) == old
    assert resolve("2026-11-20-g1-walk-0001", tmp_path) == old
    assert resolve("2026-11-21-g1-s", tmp_path) == newer
    assert resolve("squat/2026-11-21-g1-squat-0001", tmp_path) == newer
    assert resolve("latest", tmp_path) == newest
    assert signals_file(newest) == newest / "signals.mcap"


def test_what_cannot_be_found_is_said_in_one_line(tmp_path: Path) -> None:
    make(tmp_path, "walk", "2026-11-20-g1-walk-0001")
    make(tmp_path, "walk", "2026-11-20-g1-walk-0002")
    with pytest.raises(EpisodeError, match=r"2 episodes .* fit.*walk-0001, .*walk-0002"):
        resolve("2026-11-20", tmp_path)
    with pytest.raises(EpisodeError, match=r"not found.*did you mean '2026-11-20-g1-walk-0002'"):
        resolve("2026-11-20-g1-wark-0002", tmp_path)
    with pytest.raises(EpisodeError, match="no episode: expected"):
        resolve(tmp_path / "walk", tmp_path)
    with pytest.raises(EpisodeError, match="which holds 0 episodes"):
        resolve("latest", tmp_path / "nowhere")


def test_the_data_folder_comes_from_the_caller_then_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATION_DATA")
    assert data_folder() == Path("data")
    monkeypatch.setenv("STATION_DATA", "/somewhere")
    assert data_folder() == Path("/somewhere")
    assert data_folder(Path("here")) == Path("here")
