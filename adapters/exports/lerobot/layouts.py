"""Where rows, videos and what is known of each episode go: few large files in v3.0, one per episode in v2.1."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from adapters.exports.arrow_library import pa
from adapters.exports.lerobot import about, features, parquet
from adapters.exports.lerobot.parquet import Columns
from adapters.exports.lerobot.plan import Plan
from station.export.shards import place

_MEGABYTE = 1 << 20
_TOGETHER = 100  # episodes whose facts are written at once


@dataclass(frozen=True)
class Episode:
    """One episode as it stands in the data set.

    Attributes:
        index: Its number.
        task: What the robot was told.
        task_index: Number of that text.
        length: Rows.
        first_row: Number of its first row in the whole data set.
        videos: Its videos by column.
        fields: What else is known of it, as `about.FIELDS`.
        stats: Statistics by column, those of pictures in LeRobot's shape.
    """

    index: int
    task: str
    task_index: int
    length: int
    first_row: int
    videos: dict[str, Path]
    fields: dict[str, Any]
    stats: dict[str, Any] = field(default_factory=dict)


class Layout(ABC):
    """Writes a data set, episode by episode, into a folder: behind the episodes that it holds."""

    @abstractmethod
    def add(self, episode: Episode, rows: Columns) -> None:
        """Write an episode's rows and videos."""

    @abstractmethod
    def finish(self, tasks: list[str], stats: dict[str, Any], subtasks: list[str] | None) -> None:
        """Write what remains: tasks and subtasks, by number, and the statistics of all."""

    @abstractmethod
    def abandon(self) -> None:
        """Let go of open files without finishing them."""


class Version30(Layout):
    """Episodes one behind the other in files of limited size; what is known of each in parquet files."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self._folder = folder
        self._data = parquet.Appender(
            folder / "data", limit_bytes=features.DATA_MB * _MEGABYTE, per_chunk=features.CHUNK
        )
        self._about = parquet.Appender(
            folder / "meta/episodes", limit_bytes=features.DATA_MB * _MEGABYTE, per_chunk=features.CHUNK
        )
        self._videos = {camera.column: _concatenation(folder, camera.column, plan) for camera in plan.common.pictures}
        self._waiting: list[tuple[dict[str, Any], dict[str, Any]]] = []
        self._schema: Any = None

    def add(self, episode: Episode, rows: Columns) -> None:
        """Append rows and videos."""
        known: dict[str, Any] = {
            "episode_index": episode.index,
            "tasks": [episode.task],
            "length": episode.length,
            **dict(zip(("data/chunk_index", "data/file_index"), self._data.place(), strict=True)),
            "dataset_from_index": episode.first_row,
            "dataset_to_index": episode.first_row + episode.length,
        }
        self._data.add(parquet.table(rows))
        for column, video in episode.videos.items():
            names = [f"videos/{column}/{name}" for name in _PLACE_OF_A_VIDEO]
            known |= zip(names, self._videos[column].add(video, episode.length), strict=True)
        for column, stats in episode.stats.items():
            known |= {f"stats/{column}/{name}": values for name, values in stats.items()}
        self._waiting.append((known, episode.fields))
        if len(self._waiting) == _TOGETHER:
            self._write_about()

    def finish(self, tasks: list[str], stats: dict[str, Any], subtasks: list[str] | None) -> None:
        """Finish all files."""
        self._write_about()
        for files in (self._data, self._about, *self._videos.values()):
            files.close()
        parquet.write_texts(self._folder / "meta/tasks.parquet", "task", tasks)
        if subtasks is not None:
            parquet.write_texts(self._folder / "meta/subtasks.parquet", "subtask", subtasks)
        write_json(self._folder / "meta/stats.json", stats)

    def abandon(self) -> None:
        """Let go of open files."""
        for files in (self._data, self._about, *self._videos.values()):
            files.abandon()

    def _write_about(self) -> None:
        if not self._waiting:
            return
        chunk, number = self._about.place()
        here = {"meta/episodes/chunk_index": chunk, "meta/episodes/file_index": number}
        rows = pa.Table.from_pylist([known | here for known, _ in self._waiting], schema=self._schema)
        self._schema = rows.schema
        for name, kind in about.FIELDS.items():
            rows = rows.append_column(name, pa.array([fields[name] for _, fields in self._waiting], kind))
        self._about.add(rows)
        self._waiting.clear()


class Version21(Layout):
    """A file of rows and a video per camera for each episode; what is known of each in lines of JSON."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        (folder / "meta").mkdir(parents=True, exist_ok=True)
        self._episodes = (folder / "meta/episodes.jsonl").open("a", encoding="utf-8")
        self._stats = (folder / "meta/episodes_stats.jsonl").open("a", encoding="utf-8")

    def add(self, episode: Episode, rows: Columns) -> None:
        """Write rows, and give the videos their place."""
        where = {"episode_chunk": episode.index // features.CHUNK, "episode_index": episode.index}
        paths = features.PATHS["v2.1"]
        parquet.write(self._folder / paths["data_path"].format(**where), parquet.table(rows))
        for column, video in episode.videos.items():
            place(video, self._folder / paths["video_path"].format(video_key=column, **where))
        known = {"episode_index": episode.index, "tasks": [episode.task], "length": episode.length, **episode.fields}
        self._episodes.write(json.dumps(known, ensure_ascii=False) + "\n")
        self._stats.write(json.dumps({"episode_index": episode.index, "stats": episode.stats}) + "\n")

    def finish(self, tasks: list[str], stats: dict[str, Any], subtasks: list[str] | None) -> None:
        """Close all files, write the tasks."""
        self._episodes.close()
        self._stats.close()
        _write_texts(self._folder / "meta/tasks.jsonl", "task", tasks)
        if subtasks is not None:
            _write_texts(self._folder / "meta/subtasks.jsonl", "subtask", subtasks)
        # LeRobot reads those of the episodes. GR00T reads these, and cuts every one of them into the parts of the body.
        sliced = {column: {name: found[name] for name in found if name != "count"} for column, found in stats.items()}
        write_json(self._folder / "meta/stats.json", sliced)

    def abandon(self) -> None:
        """Let go of open files."""
        self._episodes.close()
        self._stats.close()


def _write_texts(file: Path, what: str, texts: list[str]) -> None:
    lines = [json.dumps({f"{what}_index": number, what: text}, ensure_ascii=False) for number, text in enumerate(texts)]
    file.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def layout_of(plan: Plan, folder: Path) -> Layout:
    """Return what writes the layout that a plan names."""
    return Version30(folder, plan) if plan.layout == "v3.0" else Version21(folder)


def write_json(file: Path, document: Any) -> None:
    """Write a document for people and programs."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(document, indent=4, ensure_ascii=False) + "\n", encoding="utf-8")


_PLACE_OF_A_VIDEO = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")


def _concatenation(folder: Path, column: str, plan: Plan) -> Any:
    from adapters.exports.lerobot.video import Concatenation

    limit = features.VIDEO_MB * _MEGABYTE
    return Concatenation(folder / "videos" / column, plan.fps, limit_bytes=limit, per_chunk=features.CHUNK)
