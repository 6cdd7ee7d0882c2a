"""``meta/info.json``: every column with its type, shape and names, and where the files lie."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adapters.exports.lerobot import depth_codes
from adapters.exports.lerobot.av_library import DEPTH_PIXELS, PIXELS
from adapters.exports.lerobot.plan import (
    ACTION,
    AGE,
    COMMANDER,
    GATE,
    STATE,
    SUBTASK,
    TIME,
    Camera,
    Layout,
    Plan,
)

CHUNK = 1000
"""Files per folder of v3.0, episodes per folder of v2.1."""
DATA_MB, VIDEO_MB = 100, 200
"""A file of v3.0 that has grown beyond this is the last but one [MB]."""

PATHS: dict[Layout, dict[str, str]] = {
    "v3.0": {
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    },
    "v2.1": {
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    },
}
INDEX = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64",
         "task_index": "int64"}  # fmt: skip
"""Columns that LeRobot itself gives every data set."""


def features(plan: Plan) -> dict[str, Any]:
    """Return every column of the data set, as LeRobot describes them."""
    common = plan.common
    found: dict[str, Any] = {
        STATE: _numbers("float32", common.state_names),
        ACTION: _numbers("float32", common.action_names),
        **{camera.column: _video(camera, plan) for camera in common.pictures},
        AGE + STATE: _numbers("float32", [one.key for one in common.state]),
        AGE + ACTION: _numbers("float32", [one.key for one in common.action]),
        **{camera.age_column: _numbers("float32", [camera.key]) for camera in common.pictures},
        TIME: _numbers("int64", None),
        GATE: _numbers("int64", None),
        COMMANDER: _numbers("int64", None),
    }
    if plan.subtasks == "marks":
        found[SUBTASK] = _numbers("int64", None)
    return {**found, **{name: _numbers(kind, None) for name, kind in INDEX.items()}}


def info(plan: Plan, *, episodes: int, rows: int, tasks: int, splits: Mapping[str, str]) -> dict[str, Any]:
    """Return the whole document."""
    found: dict[str, Any] = {
        "codebase_version": plan.layout,
        "robot_type": plan.common.robot or "unknown",
        "total_episodes": episodes,
        "total_frames": rows,
        "total_tasks": tasks,
        "chunks_size": CHUNK,
        "fps": plan.fps,
        "splits": dict(splits),
        **PATHS[plan.layout],
    }
    if not plan.common.cameras:
        found["video_path"] = None
    if plan.layout == "v3.0":
        found |= {"data_files_size_in_mb": DATA_MB, "video_files_size_in_mb": VIDEO_MB}
    else:
        found |= {"total_videos": episodes * len(plan.common.cameras), "total_chunks": -(-episodes // CHUNK)}
    return {**found, "features": features(plan)}


def _numbers(kind: str, names: list[str] | None) -> dict[str, Any]:
    return {"dtype": kind, "shape": [len(names) if names else 1], "names": names}


def _video(camera: Camera, plan: Plan) -> dict[str, Any]:
    is_depth = camera.step_m is not None
    channels = 1 if is_depth else 3
    return {
        "dtype": "video",
        "shape": [camera.height, camera.width, channels],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": camera.height,
            "video.width": camera.width,
            "video.codec": "hevc" if is_depth else plan.codec,
            "video.pix_fmt": DEPTH_PIXELS if is_depth else PIXELS,
            "video.is_depth_map": is_depth,
            "video.fps": plan.fps,
            "video.channels": channels,
            "has_audio": False,
            "is_depth_map": is_depth,
            **(depth_codes.INFO if is_depth else {}),
        },
    }
