"""Load for the long run: ten thousand small values and 30 MB of pictures a second, every one accounted for."""

from __future__ import annotations

import random
import time
from collections.abc import Sequence
from functools import cache

from benchmarks.processes import Beside, Stop
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.reader import EpisodeReader
from station.life.loop import Rate

SMALL = tuple(f"soak_state_{index}" for index in range(10))
PICTURES = tuple(keys.camera_image(f"soak_{index}") for index in range(3))
PICTURE_BYTES = 66_000
_NUMBERS = [random.Random(0).uniform(-1.0, 1.0) for _ in range(8)]
_END_S = 20.0


class Load:
    """Two processes that write whatever becomes of the bus.

    Args:
        address: The bus.
        per_s: Small values a second.
        mb_per_s: Pictures [MB/s].
    """

    def __init__(self, address: BusAddress, per_s: float = 10_000.0, mb_per_s: float = 30.0) -> None:
        picture_hz = mb_per_s * 1e6 / PICTURE_BYTES / len(PICTURES)
        self._writers = [Beside(_write, address, SMALL, per_s / len(SMALL))]
        if mb_per_s:
            self._writers.append(Beside(_write, address, PICTURES, picture_hz))

    def stop(self) -> dict[str, tuple[int, int]]:
        """Return for each key how often it was written, and how many of these the writer knows to be lost."""
        return {key: counted for writer in self._writers for key, counted in writer.stop().items()}


def value(key: str, number: int) -> bytes:
    """Return what a key holds after so many writes."""
    if key in PICTURES:
        begin = (len(PICTURES) * number + PICTURES.index(key)) * PICTURE_BYTES % len(_noise())
        return number.to_bytes(8, "little") + _noise()[begin : begin + PICTURE_BYTES - 8]
    return codec.json_vector([float(number), *_NUMBERS])


@cache
def _noise() -> bytes:
    """Return what no compression makes smaller, as with JPEG; not made by an import: it takes 0.4 s and 66 MB."""
    return random.Random(1).randbytes(1000 * PICTURE_BYTES)


def account(reader: EpisodeReader, written: dict[str, tuple[int, int]]) -> dict[str, int]:
    """Compare what was written with what an episode holds.

    Returns:
        ``messages`` in the file; ``missing``: numbers that are not in it; ``refused``: how many of these never reached
        the bus, as their writers know; ``dropped``: how many the recorder gave up, as the manifest says; ``twice``;
        ``wrong``: not the bytes that were written, or out of order.
    """
    newest = dict.fromkeys(written, 0)
    found = {"messages": 0, "missing": 0, "twice": 0, "wrong": 0}
    for message in reader.messages(list(written)):
        found["messages"] += 1
        last, newest[message.topic] = newest[message.topic], message.sequence
        found["twice"] += message.sequence == last
        found["wrong"] += message.sequence < last or message.data != value(message.topic, message.sequence)
        found["missing"] += max(0, message.sequence - last - 1)
    found["missing"] += sum(count - newest[key] for key, (count, _) in written.items())
    found["refused"] = sum(refused for _, refused in written.values())
    found["dropped"] = sum(stream.dropped for stream in reader.manifest.streams if stream.key in written)
    return found


def _write(stop: Stop, address: BusAddress, names: Sequence[str], hz: float) -> dict[str, tuple[int, int]]:
    rate, count = Rate(hz), 0

    def values() -> dict[str, bytes]:
        return {key: value(key, count) for key in names}

    with Bus(address, name=names[0]) as bus:
        while not stop():
            rate.wait()
            count += 1
            bus.publish(values())
        deadline = time.monotonic() + _END_S
        while (not bus.is_connected or bus.is_late) and time.monotonic() < deadline:
            count += 1
            bus.publish(values())
            time.sleep(0.02)
        return dict.fromkeys(names, (count, bus.lost_writes // len(names)))
