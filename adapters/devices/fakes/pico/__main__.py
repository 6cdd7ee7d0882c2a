"""``python -m adapters.devices.fakes.pico FILE``: a fake PC service that plays a script until it is stopped.

Another program that starts it gives ``--as-child``: then it says ``listening PORT`` on its standard output, begins
with the line ``go`` on its standard input, and ends with the end of that: it cannot outlive its parent.
"""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from adapters.devices.fakes.pico.run import run
from adapters.devices.fakes.pico.service import DEFAULT_PORT, PicoService
from station.errors import StationError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; return the exit code."""
    options = _parser().parse_args(arguments)

    def announce(service: PicoService, go: threading.Event, stop: threading.Event) -> None:
        sys.stdout.write(f"listening {service.port}\n")
        sys.stdout.flush()
        if options.as_child:
            threading.Thread(target=_obey, args=(go, stop), name="parent-pipe", daemon=True).start()
        else:
            go.set()

    try:
        run(options.file, options.port, start_s=options.start_s, on_listening=announce)
    except StationError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


def _obey(go: threading.Event, stop: threading.Event) -> None:
    for word in sys.stdin:
        if word.strip() == "go":
            go.set()
    stop.set()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m adapters.devices.fakes.pico", description=__doc__)
    parser.add_argument("file", type=Path, help="the script, JSON")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"TCP port; default {DEFAULT_PORT}, 0: any")
    parser.add_argument("--start-s", type=float, default=0.0, help="time of the script to begin at [s]; default 0")
    parser.add_argument("--as-child", action="store_true", help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
