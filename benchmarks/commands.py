"""The command of TWIST2 as benchmark writers send it: numbers of 17 digits, as real ones have."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1 import twist_keys
from benchmarks import stock
from benchmarks.processes import Stop
from station.bus import codec
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.clock import SYSTEM
from station.life.loop import Rate, real_time

Floats = NDArray[np.float64]


def vectors() -> list[Floats]:
    """Return body, hands and neck near a standing pose: float32 widened to float64, the longest JSON there is."""
    random = np.random.default_rng(7)
    made = [random.uniform(-0.3, 0.3, size).astype(np.float32).astype(np.float64) for size in stock.COMMAND_SIZES]
    made[0][:6] = (0.0, 0.0, 0.75, 0.0, 0.0, 0.0)
    return made


def encoded(values: list[Floats], time_ns: int) -> dict[str, bytes]:
    """Return what `station.bus.client.Bus.publish` takes."""
    pairs = zip(stock.COMMAND_KEYS, values, strict=True)
    return {key: codec.json_vector(vector) for key, vector in pairs} | {twist_keys.T_ACTION: b"%d" % time_ns}


def write_native(stop: Stop, address: BusAddress, hz: float, is_fifo: bool = False) -> int:
    """Publish the command at a rate until told to stop; return how often.

    Args:
        stop: Says when.
        address: The bus.
        hz: Rate [Hz].
        is_fifo: Whether to ask for real-time scheduling, as the motion server does.
    """
    values, rate, count = vectors(), Rate(hz), 0
    with Bus(address, name="bench-writer") as line:
        if is_fifo:
            real_time()
        while not stop():
            rate.wait()
            line.publish(encoded(values, time.monotonic_ns()))
            count += 1
    return count


def write_stock(stop: Stop, port: int, hz: float) -> int:
    """Send the command as a stock script would, but on time, so that both writers keep the same rate."""
    values, client, count = vectors(), stock.Client(port), 0
    due_ns = time.monotonic_ns()
    while not stop():
        due_ns += round(1e9 / hz)
        SYSTEM.sleep_until(due_ns)
        client.send_command(values, time.monotonic_ns())
        count += 1
    client.close()
    return count
