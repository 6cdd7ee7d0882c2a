"""A headset in a process of its own, as the library wants it; each of its samples is a line of JSON.

``python -m tests.adapters.devices.pico.wearing PORT PATIENCE_S`` prints one for each new sample until its input ends.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from adapters.devices.fakes.pico.service import PicoService
from adapters.devices.pico.headset import Headset
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample, Pose
from tests.waiting import DEADLINE_S

HUNG = 1
"""Exit code of a process that was ended because the library hung in its `close`, as it does on a busy machine."""

_GONE_NS = 3_600_000_000_000


class Wearer:
    """The process, seen from the test."""

    def __init__(self, process: subprocess.Popen[str], service: PicoService) -> None:
        self._process, self._service = process, service
        self._epoch_ns = 0

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
        assert self._process.stdout is not None
        while True:
            ready, _, _ = select.select([self._process.stdout], [], [], DEADLINE_S)
            assert ready, "no sample came"
            sample: dict[str, Any] = json.loads(self._process.stdout.readline())
            sample["capture_ns"] -= self._epoch_ns
            if sample["capture_ns"] > 0:
                return sample


@contextmanager
def wearing(service: PicoService, patience_s: float = 2 * DEADLINE_S) -> Iterator[Wearer]:
    command = [sys.executable, "-m", "tests.adapters.devices.pico.wearing", str(service.port), str(patience_s)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        assert process.stdin is not None
        try:
            assert service.wait_for_listener(DEADLINE_S)
            yield Wearer(process, service)
            process.stdin.close()
            assert process.wait(DEADLINE_S) in (0, HUNG), "it must end, by itself or because the library did not let go"
        finally:
            process.kill()


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
