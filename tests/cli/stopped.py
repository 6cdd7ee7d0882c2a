"""A simulated robot, and what a stop from the command line does to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

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


class Stop(NamedTuple):
    """What came of a stop and its release.

    Attributes:
        steps: Published between the stop and the first damped one.
        said: What was printed at both; a robot whose word is late makes it another.
    """

    steps: int
    said: tuple[str, str]


IN_TIME = ("every robot on this bus is damped; `station estop --reset` releases", "e-stop released")


def press(home: Home, *arguments: str) -> str:
    """Stop every robot; return what was said: the bus has the stop, and who waits for the gate sees the robot obey."""
    done = home.run("estop", *arguments)
    said = done.stdout if done.returncode == 0 else done.stderr
    late = ("latched, but no robot runs on this bus; `station estop --reset` releases",
            "the bus has the stop, but not every robot obeys: ")  # fmt: skip
    assert any(words in said for words in (IN_TIME[0], *late)), said
    return said.strip()


def release(home: Home) -> str:
    """Release the stop; return what was said: the bus has it, and who waits for the gate sees the robot obey."""
    done = home.run("estop", "--reset")
    said = done.stdout if done.returncode == 0 else done.stderr
    assert said == f"{IN_TIME[1]}\n" or "the bus has the release, but " in said, said
    return said.strip()


def stop_and_reset(home: Home) -> Stop:
    """Stop the robot and release it."""
    with logged(home.bus) as log:
        with StockCommander(home.bus):
            wait_until(lambda: states(log.writes)[-1:] == ["tracking"])
            stopped = press(home, "--reason", "a test")
            wait_until(lambda: "stopped" in states(log.writes))
            released = release(home)
            wait_until(lambda: "waiting" in states(after_the_stop(log)))
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
    return Stop(states(log.writes[stopped_at:]).index("stopped"), (stopped, released))


def after_the_stop(log: Log) -> list[Write]:
    writes = list(log.writes)
    stops = [n for n, write in enumerate(writes) if write.key == GATE and b'"stopped"' in (write.value or b"")]
    return writes[stops[-1] :] if stops else []


def events(log: Log) -> list[dict[str, Any]]:
    return [codec.parse_json(value) for value in log.values(keys.EVENT)]
