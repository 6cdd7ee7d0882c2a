"""A simulated robot, and what a stop from the command line does to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station.bus import codec, keys
from station.bus.tap import Write
from tests.cli.running import Home, Running, new_home
from tests.servers.g1_station import LIGHT, Log, StockCommander, logged
from tests.waiting import wait_until

GATE = keys.command_gate(twist_keys.TWIST2_ROBOT)
BOOK = "runbook: t\nrobot: unitree_g1_with_hands\nsteps:\n  - start: g1\n    ready_within: 60s\n"
SETTINGS = [word for setting in LIGHT for word in ("--set", f"g1.{setting}")]


@contextmanager
def driven_robot() -> Iterator[tuple[Home, Running]]:
    """A simulated robot; what commands it comes and goes."""
    with new_home() as home:
        book = Path(home.environment["XDG_RUNTIME_DIR"]) / "book.yaml"
        book.write_text(BOOK)
        with home.running("up", str(book), "--yes", *SETTINGS) as station:
            station.wait_for("✓ start g1")
            yield home, station


def states(writes: list[Write]) -> list[str]:
    """Return the states of the gate, in order."""
    return [codec.parse_json(write.value)["state"] for write in writes if write.key == GATE and write.value]


def stop_and_reset(home: Home) -> int:
    """Stop the robot and release it; return how many steps were published between the stop and the first damped one."""
    with logged(home.bus) as log:
        with StockCommander(home.bus):
            wait_until(lambda: states(log.writes)[-1:] == ["tracking"])
            done = home.run("estop", "--reason", "a test")
            assert done.returncode == 0
            assert "every robot on this bus is damped; `station estop --reset` releases" in done.stdout
            wait_until(lambda: "stopped" in states(log.writes))
            assert home.run("estop", "--reset").stdout == "e-stop released\n"
            wait_until(lambda: states(after_the_stop(log))[-1:] == ["waiting"])
        wait_until(lambda: not codec.parse_json(log.last(GATE))["needs_silence"])  # another one may begin
    targets = [write for write in log.writes if write.key == keys.target(twist_keys.TWIST2_ROBOT)]
    first = next(
        n for n, write in enumerate(log.of(GATE)) if codec.parse_json(write.value or b"")["state"] == "stopped"
    )
    stiffness = codec.parse_f64(targets[first].value or b"")[len(G1_29) : 2 * len(G1_29)]
    assert not stiffness.any(), "damped: no stiffness"
    names = [event["name"] for event in events(log)]
    assert names.index("estop") < names.index("operator-reset")
    stopped_at = next(n for n, write in enumerate(log.writes) if write.key == keys.ESTOP)
    return states(log.writes[stopped_at:]).index("stopped")


def after_the_stop(log: Log) -> list[Write]:
    writes = list(log.writes)
    stops = [n for n, write in enumerate(writes) if write.key == GATE and b'"stopped"' in (write.value or b"")]
    return writes[stops[-1] :] if stops else []


def events(log: Log) -> list[dict[str, Any]]:
    return [codec.parse_json(value) for value in log.values(keys.EVENT)]
