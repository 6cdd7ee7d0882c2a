"""A headset in a process of its own, as the library wants it; each of its samples is a line of JSON.

``python -m tests.adapters.devices.pico.wearing PORT PATIENCE_S`` prints one for each new sample until its input ends.
"""

from __future__ import annotations

import json
import queue
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from adapters.devices.fakes.pico.service import PicoService
from adapters.devices.pico.headset import Headset
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample, Pose
from tests.waiting import DEADLINE_S, wait_until

HUNG = 1
"""Exit code of a process that was ended because the library hung in its `close`, as it does on a busy machine."""

_GONE_NS = 3_600_000_000_000


class Wearer:
    """The process, seen from the test; where the library hung in its `close` and took it down, it is started anew."""

    def __init__(self, service: PicoService, patience_s: float) -> None:
        self._service, self._patience_s = service, patience_s
        self._epoch_ns = 0
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._start()

    def _start(self) -> None:
        command = [sys.executable, "-m", "tests.adapters.devices.pico.wearing"]
        self.process = subprocess.Popen(
            [*command, str(self._service.port), str(self._patience_s)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, args=(self.process,), daemon=True)
        self._reader.start()

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._lines.put(line)
        process.stdout.close()

    def end(self) -> int:
        """Have it end; return its exit code."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            return self.process.wait(DEADLINE_S)
        finally:
            self.process.kill()
            self.process.wait()
            self._reader.join()

    def begin(self) -> None:
        """Begin a new test, at a time of the headset's at which all that was seen before is long gone."""
        self._epoch_ns += _GONE_NS

    def send(self, frame: dict[str, Any]) -> None:
        """Send a frame, whose times are of this test."""
        self._service.send(_at(frame, self._epoch_ns))

    def after(self, frame: dict[str, Any]) -> dict[str, Any]:
        """Send a frame and return the sample that comes of it."""
        self.send(frame)
        return self.next()

    def next(self) -> dict[str, Any]:
        while True:
            try:
                line = self._lines.get(timeout=DEADLINE_S)
            except queue.Empty:
                raise AssertionError("no sample came") from None
            sample: dict[str, Any] = json.loads(line)
            sample["capture_ns"] -= self._epoch_ns
            if sample["capture_ns"] > 0:
                return sample

    def until_one_comes(self, frame: dict[str, Any]) -> dict[str, Any]:
        """Send a frame again and again, each a millisecond later, as a headset that is worn does; return a sample."""

        def comes() -> bool:
            self.send(frame)
            frame["timeStampNs"] += 1_000_000
            if self.process.poll() == HUNG:
                self.end()
                self._start()
            return not self._lines.empty()

        wait_until(comes)
        return self.next()


@contextmanager
def wearing(service: PicoService, patience_s: float = 2 * DEADLINE_S) -> Iterator[Wearer]:
    wearer = Wearer(service, patience_s)
    try:
        assert service.wait_for_listener(DEADLINE_S)
        yield wearer
    finally:
        ended = wearer.end()
    assert ended in (0, HUNG), "it must end, by itself or because the library did not let go"


def _at(frame: dict[str, Any], epoch_ns: int) -> dict[str, Any]:
    """Return a frame with its time, and that of its body, moved."""
    moved = {
        name: _at(kind, epoch_ns) if isinstance(kind, dict) and "timeStampNs" in kind else kind
        for name, kind in frame.items()
    }
    return moved | {"timeStampNs": frame["timeStampNs"] + epoch_ns}


def _plain(reading: OperatorSample) -> dict[str, Any]:
    def pose(item: Pose | None) -> list[float] | None:
        return item and [*item.position.tolist(), *item.quat_wxyz.tolist()]

    body = reading.body
    return {
        "capture_ns": reading.capture_ns,
        "controls": dict(reading.controls),
        "head": pose(reading.head),
        "left": pose(reading.left),
        "right": pose(reading.right),
        "body": body and {"positions": body.positions.tolist(), "quats_wxyz": body.quats_wxyz.tolist()},
        "hands": {side: hand.tolist() for side, hand in reading.hands.items()},
    }


def main() -> None:
    port, patience_s = int(sys.argv[1]), float(sys.argv[2])
    headset = Headset(port=port, patience_s=patience_s)
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        try:
            reading = headset.read()
        except DeviceError:
            headset.close()
            headset, reading = Headset(port=port), None
        if reading is not None:
            sys.stdout.write(json.dumps(_plain(reading)) + "\n")
            sys.stdout.flush()
        time.sleep(0.001)


if __name__ == "__main__":
    main()
