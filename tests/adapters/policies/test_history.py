"""A window of frames equals the queue that upstream keeps."""

from __future__ import annotations

from collections import deque

import numpy as np

from adapters.policies.history import FrameHistory


def test_the_window_equals_a_queue_of_frames_at_every_step() -> None:
    history, queue = FrameHistory(3, 4), deque([np.zeros(4, np.float32)] * 3, maxlen=3)
    random = np.random.default_rng(0)
    for _ in range(10):
        np.testing.assert_array_equal(history.flat, np.concatenate(queue))
        frame = random.normal(size=4).astype(np.float32)
        history.push(frame)
        queue.append(frame)


def test_filling_and_clearing_replace_every_frame() -> None:
    history = FrameHistory(2, 2)
    history.fill(np.arange(4, dtype=np.float32))
    np.testing.assert_array_equal(history.flat, [0, 1, 2, 3])
    history.clear()
    assert not history.flat.any()
