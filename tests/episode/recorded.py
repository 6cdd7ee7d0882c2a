"""Episodes as a recorder makes them, without its process: writes in, a closed folder out."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path

from station.bus.tap import Write
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.recording import Recording
from tests.episode.writes import Native


def recorded(data: Path, writes: Iterable[Write] = (), *, task: str = "walk") -> Path:
    """Return the folder of an episode in which these were written, now and in this order."""
    cli = Native("record")
    recording = Recording(RecordingOptions(data=data, min_free_mb=0.0), backend="replication", is_lossless=True)
    recording.feed([cli.request("start", task=task)])
    for write in writes:
        recording.feed([write._replace(mono_ns=time.monotonic_ns())])
    recording.feed([cli.request("stop")])
    assert recording.close(60.0)
    answers = {answer.id: answer for answer in recording.answers.pop()}
    assert answers["stop"].ok, answers["stop"].reason
    return Path(answers["stop"].path or "")
