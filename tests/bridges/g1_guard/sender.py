"""A station that does nothing but arm and command: ``python -m tests.bridges.g1_guard.sender PORT [STAMPS]``.

It commands for 60 s at most, and arms until it has been armed once. The file STAMPS has the instant of its last command
[ns, monotonic], whenever it is killed.
"""

from __future__ import annotations

import mmap
import struct
import sys
import time
from pathlib import Path

from adapters.robots.g1.dds.guard_client import GuardClient
from tests.bridges.g1_guard.bench import KD, KP, Q


def stamps(path: str) -> mmap.mmap:
    with Path(path).open("wb+") as file:
        file.write(bytes(8))
        file.flush()
        return mmap.mmap(file.fileno(), 8)


def main(port: int, stamp: mmap.mmap | bytearray) -> None:
    deadline, has_told = time.monotonic() + 60, False
    with GuardClient(port=port) as client:
        client.arm()
        while time.monotonic() < deadline:
            status = client.poll()
            if client.why_not_armed and not has_told:
                client.arm()
            if client.is_armed and not has_told:
                has_told = True
                print("armed", flush=True)  # noqa: T201
            if status is not None:
                struct.pack_into("<q", stamp, 0, time.monotonic_ns())
                client.send(status.state_tick, Q, KP, KD)
            time.sleep(0.02)


if __name__ == "__main__":
    main(int(sys.argv[1]), stamps(sys.argv[2]) if len(sys.argv) > 2 else bytearray(8))
