"""``python -m adapters.devices.fakes.pico FILE``: a fake PC service that plays a script until it is stopped.

Another program that starts it gives ``--on-leash``: then it says ``listening PORT`` on its standard output, begins
with the line ``go`` on its standard input, and ends with the end of that: it cannot outlive who started it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from adapters.devices.fakes.pico import script as scripts
from adapters.devices.fakes.pico.play import play
from adapters.devices.fakes.pico.service import DEFAULT_PORT, PicoService
from station.errors import StationError

_LOOK_S = 0.1
_PRIORITY = 10  # below the station's own servers


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; return the exit code."""
    options = _parser().parse_args(arguments)
    stop, go = threading.Event(), threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    _be_punctual()
    try:
        script = scripts.load(options.file)
        with PicoService(options.port) as service:
            sys.stdout.write(f"listening {service.port}\n")
            sys.stdout.flush()
            if options.on_leash:
                threading.Thread(target=_obey, args=(go, stop), name="leash", daemon=True).start()
            else:
                go.set()
            _wait(service, go, stop)
            play(script, service, stop.is_set, start_s=options.start_s)
    except StationError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


def _be_punctual() -> None:
    """Stand in for a machine of its own, which other work here does not hold up, where that is permitted."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))


def _obey(go: threading.Event, stop: threading.Event) -> None:
    for word in sys.stdin:
        if word.strip() == "go":
            go.set()
    stop.set()


def _wait(service: PicoService, go: threading.Event, stop: threading.Event) -> None:
    while not stop.is_set() and not (go.wait(_LOOK_S) and service.wait_for_listener(_LOOK_S)):
        pass


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m adapters.devices.fakes.pico", description=__doc__)
    parser.add_argument("file", type=Path, help="the script, JSON")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"TCP port; default {DEFAULT_PORT}, 0: any")
    parser.add_argument("--start-s", type=float, default=0.0, help="time of the script to begin at [s]; default 0")
    parser.add_argument("--on-leash", action="store_true", help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
