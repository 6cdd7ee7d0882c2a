"""A fake headset whose buttons are pressed when a test says so, and not at times of a script.

It is the fake of ``python -m adapters.devices.fakes.pico``, in a process of its own and under the real library; what
the wearer does and what goes wrong comes as lines of JSON on its standard input, as a script has it but for the time::

    {"control": {"press": "right_primary", "for_s": 0.3}}
    {"fault": {"kind": "silence", "for_s": 1.0}}
    {"poison": true}
    {"let_go": true}
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from adapters.devices.fakes.pico.play import Wearer
from adapters.devices.fakes.pico.script import Control, Fault, Script
from adapters.devices.fakes.pico.service import PicoService
from adapters.devices.fakes.punctual import be_punctual
from station.life.loop import Rate

PRESS_S = 0.3
_SEEN_S = 0.2  # a release is believed after three ticks of what drives
AGAIN_S = 5.0
_LOOK_S = 0.01
_ROOT = Path(__file__).parents[2]


class WornHeadset:
    """The test's end of it; gone with `close`.

    Args:
        motion: What its wearer does, forwards and backwards for ever.
    """

    def __init__(self, motion: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.servers.worn_headset", motion],
            cwd=_ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        self.port = int(self._process.stdout.readline())

    def press(
        self, *controls: str, until: Callable[[], object], for_s: float = PRESS_S, again_s: float, timeout_s: float
    ) -> None:
        """Press controls until something is so: again where nothing came of it for a time, as a person does, because a
        machine that is busy may not have seen it."""
        end_s = time.monotonic() + timeout_s
        while not until():
            assert time.monotonic() < end_s, f"nothing came of pressing {'+'.join(controls)}: {until}"
            self._tell(control={"set": dict.fromkeys(controls, 1.0), "for_s": for_s})
            time.sleep(for_s + _SEEN_S)
            pressed_s = time.monotonic()
            while not until() and time.monotonic() < pressed_s + again_s:
                time.sleep(_LOOK_S)

    def hold(self, values: Mapping[str, float]) -> None:
        """Hold controls at values until `let_go`."""
        self._tell(control={"set": dict(values)})

    def let_go(self) -> None:
        """Let go of all that is held."""
        self._tell(let_go=True)

    def be_silent(self, for_s: float) -> None:
        """Send nothing for a time [s]."""
        self._tell(fault={"kind": "silence", "for_s": for_s})

    def poison(self) -> None:
        """Send what makes the library abort its process."""
        self._tell(poison=True)

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def _tell(self, **order: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()


class _Worn:
    """The process's end: a script that grows."""

    def __init__(self, motion: str) -> None:
        self._controls: list[Control] = []
        self._faults: list[Fault] = []
        self._script = Script(motion=motion, repeat="swing", controls=self._controls, faults=self._faults)
        self._wearer = Wearer(self._script)
        self._is_poisoned = False
        self._is_over = threading.Event()
        self._began_s, self._began_ns, self._number = time.monotonic(), time.time_ns(), 0

    def obey(self, line: str) -> None:
        order = json.loads(line)
        at_s = time.monotonic() - self._began_s
        if "control" in order:
            self._controls.append(Control(at_s=at_s, **order["control"]))
        elif "fault" in order:
            self._faults.append(Fault(at_s=at_s, **order["fault"]))
        elif "let_go" in order:
            self._controls.clear()
        else:
            self._is_poisoned = True

    def play(self, service: PicoService) -> None:
        """Send a frame, the one that is due."""
        due = int((time.monotonic() - self._began_s) * self._script.rate_hz)
        self._number = max(self._number + 1, due)
        frame = self._wearer.frame(self._number, self._began_ns)
        if frame is None:
            return
        if self._is_poisoned and service.listeners:
            frame, self._is_poisoned = {**frame, "Head": {"pose": "nowhere,0,0,0,0,0,1"}}, False
        service.send(frame)

    def run(self) -> None:
        rate = Rate(self._script.rate_hz)
        with PicoService(0) as service:
            sys.stdout.write(f"{service.port}\n")
            sys.stdout.flush()
            threading.Thread(target=self._listen, daemon=True).start()
            while not self._is_over.is_set():
                rate.wait()
                self.play(service)

    def _listen(self) -> None:
        for line in sys.stdin:
            self.obey(line)
        self._is_over.set()  # the test is gone


if __name__ == "__main__":
    be_punctual()
    _Worn(sys.argv[1]).run()
