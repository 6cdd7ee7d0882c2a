"""The console server: a running station in a browser. ``station console`` starts one and prints its links."""

from __future__ import annotations

from station import libraries
from station.life.server import Life, ServerKind
from station.web.config import ConsoleConfig


def main(config: ConsoleConfig, life: Life) -> int:
    """Serve pages until asked to stop; return the exit code."""
    from station.web.console import Console

    with Console(config, life.bus.address, life.name) as console:
        return console.serve(life)


KIND = ServerKind(
    name="console",
    role="console",
    summary="shows a running station in a browser, with a stop",
    config=ConsoleConfig,
    main=main,
    expect=lambda config: libraries.expect("the console", "starlette", "console"),
    bus_timeout_s=0.25,
)
