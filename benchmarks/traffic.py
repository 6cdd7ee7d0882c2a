"""Load for a recorder: many small values and some large ones, each with a number by which it can be told apart."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Sequence

from benchmarks.processes import Stop
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.loop import Rate

SMALL_PER_S, IMAGE_MB_PER_S = 10_000.0, 30.0
SMALL_KEYS = tuple(f"bench_state_{index}" for index in range(10))
IMAGE_KEYS = tuple(keys.camera_image(f"bench_{index}") for index in range(3))
IMAGE_BYTES = 66_000
_NOISE_BYTES = 32 << 20  # a compressor looks back no further than 2 MB: no picture repeats one that it remembers


def write_small(stop: Stop, address: BusAddress, per_s: float) -> dict[str, int]:
    """Publish so many small values a second, ten keys at a time; return how many of each key the bus took."""
    numbers = [random.Random(seed).uniform(-1.0, 1.0) for seed in range(8)]
    text = json.dumps(numbers)[1:].encode()
    return _write(stop, address, SMALL_KEYS, per_s / len(SMALL_KEYS), lambda count, _: b"[%d, %s" % (count, text))


def write_images(stop: Stop, address: BusAddress, mb_per_s: float) -> dict[str, int]:
    """Publish pictures of 66 kB that no compression makes smaller, like JPEG; return how many of each key."""
    noise, size = random.Random(1).randbytes(_NOISE_BYTES), IMAGE_BYTES - 8
    hz = mb_per_s * 1e6 / IMAGE_BYTES / len(IMAGE_KEYS)

    def picture(count: int, place: int) -> bytes:
        begin = (count * len(IMAGE_KEYS) + place) * size % (_NOISE_BYTES - size)
        return count.to_bytes(8, "little") + noise[begin : begin + size]

    return _write(stop, address, IMAGE_KEYS, hz, picture)


def _write(
    stop: Stop, address: BusAddress, names: Sequence[str], hz: float, value: Callable[[int, int], bytes]
) -> dict[str, int]:
    rate, count = Rate(hz), 0
    with Bus(address, name="bench-load", timeout_s=1.0) as line:
        while not stop():
            rate.wait()
            count += 1
            line.publish({name: value(count, place) for place, name in enumerate(names)})
        if line.lost_writes:
            raise RuntimeError(f"the bus refused {line.lost_writes} writes")
    return dict.fromkeys(names, count)
