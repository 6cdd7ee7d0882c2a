"""Cameras that show noise, as JPEG with the time in each."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

import numpy as np
import simplejpeg

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus

AT = slice(6, 26)
"""Where the time [ms since 1970] stands in a picture: in a comment of the JPEG."""


@contextlib.contextmanager
def cameras(address: BusAddress, names: tuple[str, ...]) -> Iterator[None]:
    """Write pictures of 42 kB, 30 times a second, for each camera."""
    noise = np.random.default_rng(1).integers(0, 256, (152, 208, 3), dtype=np.uint8)
    over, shown = threading.Event(), simplejpeg.encode_jpeg(noise, quality=78)

    def write() -> None:
        with Bus(address, name="camera", timeout_s=5.0) as bus:
            while not over.wait(1 / 30):
                comment = b"\xff\xfe" + (22).to_bytes(2, "big") + b"%020.6f" % (time.time() * 1e3)
                bus.publish(dict.fromkeys(map(keys.camera_image, names), shown[:2] + comment + shown[2:]))

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
