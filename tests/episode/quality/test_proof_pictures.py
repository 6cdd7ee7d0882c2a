"""What looking at pictures costs a check."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from station.episode.quality import picture_contents
from tests.episode.scenes import file_of
from tests.figures import Figures

PICTURES = 200
LIMIT_MS = 1.5
"""A file of 60 kB: nearly all of it is the unpacking of its bytes, which no scale of decoding saves."""
PARALLEL_MS = 0.5


def test_a_picture_that_is_looked_at_takes_little_time_of_a_core(proof: Figures) -> None:
    rng = np.random.default_rng(1)
    grey = np.add.outer(np.linspace(0.0, 90.0, 480), np.linspace(40.0, 120.0, 640))
    files = [file_of(grey + rng.normal(0.0, 6.0, grey.shape), quality=85) for _ in range(10)]
    _, decode = picture_contents.decoder()
    began_s = time.thread_time()
    looks = [picture_contents.look(decode, files[number % len(files)]) for number in range(PICTURES)]
    took_ms = (time.thread_time() - began_s) / PICTURES * 1e3
    kilobytes = len(files[0]) // 1000
    what = f"looking at a picture of 640x480 px and {kilobytes} kB, processor time"
    proof.figure(what, took_ms, "ms", f"{LIMIT_MS:g} ms")
    assert None not in looks
    assert took_ms < LIMIT_MS
    with ThreadPoolExecutor(picture_contents.THREADS) as pool:
        began_s = time.perf_counter()
        looks = list(pool.map(lambda n: picture_contents.look(decode, files[n % len(files)]), range(PICTURES)))
        wall_ms = (time.perf_counter() - began_s) / PICTURES * 1e3
    proof.figure(
        f"the same in {picture_contents.THREADS} threads, time that passes", wall_ms, "ms", f"{PARALLEL_MS:g} ms"
    )
    assert None not in looks
    assert wall_ms < PARALLEL_MS
