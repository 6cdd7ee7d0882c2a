"""Tap readers as the recorder's process opens them, and what is asked of one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from servers.recorder import KIND
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.tap_reader import TapReader
from station.life.server import Life
from tests.waiting import wait_until

LONG_S = 600.0
Make = Callable[..., TapReader]


@contextmanager
def tap_readers(address: BusAddress, data: Path) -> Iterator[Make]:
    """Give what opens a tap reader, with options of its own; at the end all are closed."""
    made: list[tuple[TapReader, Life]] = []
    with Bus(address, name="recorder", timeout_s=5.0) as line:

        def build(**options: Any) -> TapReader:
            chosen = RecordingOptions(data=data, min_free_mb=0.0, **{"preroll_s": LONG_S, **options})
            life = Life(KIND, "recorder", line, "")
            made.append((TapReader(chosen, life, backend=None, resume_s=5.0, take_up_s=LONG_S), life))
            return made[-1][0]

        yield build
        for tap_reader, life in made:
            tap_reader.recording.close()
            tap_reader.close()
            life.end("test")


def ask(tap_reader: TapReader, bus: Bus, action: str, *, but: str = "") -> str:
    """Have a request done; return the path of its episode. An answer to another one may come before."""
    bus.publish({keys.RECORD: codec.json_object({"id": action, "action": action, "task": "walk"})})
    found: list[Any] = []

    def answered() -> bool:
        tap_reader.step()
        tap_reader.recording.poll()
        found.extend(answer for answer in tap_reader.recording.answers.pop() if answer.id != but)
        return bool(found)

    wait_until(answered)
    (answer,) = found
    assert answer.ok, answer.reason
    return str(answer.path)
