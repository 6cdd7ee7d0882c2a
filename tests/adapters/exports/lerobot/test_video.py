from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from adapters.exports.lerobot.av_library import PIXELS, Codec
from adapters.exports.lerobot.video import VideoWriter, expect_frames
from tests.adapters.exports.lerobot.test_scheduling import told_of_a_new_thread


def scheduling() -> set[tuple[int, int]]:
    threads = [int(task.name) for task in Path("/proc/self/task").iterdir()]
    return {(os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority) for thread in threads}


@pytest.mark.parametrize("codec", ["h264", "av1"])
def test_an_encoder_takes_no_precedence_over_a_robot(tmp_path: Path, codec: Codec) -> None:
    av = pytest.importorskip("av")
    before, told = scheduling(), told_of_a_new_thread()
    writer = VideoWriter(tmp_path / "video.mp4", 64, 96, 30, codec, 30)
    for level in range(10):
        grey = np.full((64, 96, 3), 25 * level, dtype=np.uint8)
        writer.add(av.VideoFrame.from_ndarray(grey, format="rgb24").reformat(format=PIXELS))
    assert scheduling() == before  # SVT-AV1, run by root, asks for SCHED_FIFO 99 for itself and its caller
    writer.close()
    assert scheduling() == before
    assert told_of_a_new_thread() == told, "a thread inherits what the C library keeps of the one that starts it"
    expect_frames(tmp_path / "video.mp4", 10, "video")
