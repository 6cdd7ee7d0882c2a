"""Two commanders on one key, as real processes: trials of what is told and done."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.tap import Write
from station.control.gate import LONGEST_SLEW_TICK_S
from station.life.events import Event, decode
from station.protocols import Floats
from tests.servers.g1_station import FORMAT, ROBOT, G1Process, Log, StockCommander, logged
from tests.waiting import wait_until

COMMAND = FORMAT.key
HOST = socket.gethostname()


@contextmanager
def commander(address: BusAddress, name: str, motion: str, *others: str) -> Iterator[subprocess.Popen[bytes]]:
    """A motion server of ours that plays for ever."""
    sets = (f"motion={motion}", "loop=true", "enter_s=0.1", "leave_s=0.1", *others)
    words = [word for setting in sets for word in ("--set", setting)]
    process = subprocess.Popen(
        [sys.executable, "-m", "station", "serve", "motion", "--bus", address.url, "--name", name, *words],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=dict(os.environ),
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def is_of(write: Write, name: str) -> bool:
    return write.key == COMMAND and bool(write.stamp) and f" {name}.".encode() in (write.stamp or b"")


def writes_of(log: Log, name: str) -> list[Write]:
    return [write for write in list(log.writes) if is_of(write, name)]


def told_by_robot(log: Log) -> list[Event]:
    """What the low-level server says of rivals; our motion server says so of its own key too."""
    return [event for event in log.events("second-writer") if event.source == "g1"]


def used(log: Log) -> Floats:
    return np.array([codec.parse_f64(value) for value in log.values(keys.command_used(ROBOT))])


def expect_no_kick(log: Log) -> None:
    """No tick moved an element by more than its rate allows for the longest tick there is."""
    assert (np.abs(np.diff(used(log), axis=0)) <= FORMAT.rate * LONGEST_SLEW_TICK_S + 1e-9).all()


def heard_before_told(log: Log, name: str) -> int:
    """Writes of a commander that were on the bus before the robot's first word of rivals."""
    count = 0
    for write in list(log.writes):
        event = decode(write.value) if write.key == keys.EVENT and write.value else None
        if event is not None and (event.name, event.source) == ("second-writer", "g1"):
            break
        count += is_of(write, name)
    return count


def changes(log: Log) -> list[tuple[str, str]]:
    """Return the changes of the gate, each from what and to what."""
    return [(event.detail["from"], event.detail["to"]) for event in log.events("gate")]


def used_while_tracking(log: Log) -> Floats:
    """Return the newest commands that were followed and not blended, at most fifty."""
    followed = [vector for vector, state in zip(used(log), log.states(), strict=False) if state == "tracking"]
    return np.array(followed[-50:])


def refuse_the_second(address: BusAddress, *robot: str) -> tuple[list[tuple[str, str]], int]:
    """A second motion server begins beside one that is obeyed, and takes over when that one is killed.

    Args:
        address: Of the bus.
        robot: Settings of the robot's server.

    Returns:
        How the gate changed while both wrote, and how many writes of the second came before it was told of.
    """
    with (
        logged(address) as log,
        G1Process(address, *robot),
        commander(address, "first", "builtin:stand") as first,
    ):
        wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")])
        followed = len(changes(log))
        # At another rate than the first: in step with it, each of its writes may be overwritten before it is seen.
        with commander(address, "second", "builtin:wave", "rate_hz=47") as second:
            wait_until(lambda: told_by_robot(log))
            told = told_by_robot(log)[0].detail
            wait_until(lambda: len(writes_of(log, "second")) > 150)
            assert told["obeyed"] == f"first (pid {first.pid} on {HOST})"
            assert told["refused"] == [f"second (pid {second.pid} on {HOST})"]
            assert [source.split(".")[:2] for source in told["writers"]] == [
                ["first", str(first.pid)], ["second", str(second.pid)]
            ]  # fmt: skip
            wait_until(lambda: log.gate()["refused"] > 100)
            newest, lost = used_while_tracking(log), changes(log)[followed:]
            firsts = {write.value for write in writes_of(log, "first")}
            obeyed = [codec.parse_json_vector(value) for value in firsts if value is not None]
            if not lost:
                assert not log.events("command-handover")
                for vector in newest:
                    assert min(np.abs(vector - other).max() for other in obeyed) < 1e-9
                expect_handover(log, first, second)
    expect_no_kick(log)
    assert not log.events("fall")
    return lost, heard_before_told(log, "second")


def expect_handover(log: Log, first: subprocess.Popen[bytes], second: subprocess.Popen[bytes]) -> None:
    """Kill the first: the second is followed in its place, with a blend."""
    before = len(log.events("gate"))
    first.send_signal(signal.SIGKILL)
    wait_until(lambda: log.events("command-handover"))
    wait_until(lambda: "tracking" in [event.detail["to"] for event in log.events("gate")[before:]])
    handover = log.events("command-handover")[0].detail
    assert handover["obeyed"] == f"second (pid {second.pid} on {HOST})"
    assert handover["reason"] == f"first (pid {first.pid} on {HOST}) has been silent"
    wait_until(lambda: [event for event in told_by_robot(log) if event.detail.get("ended")])
    assert ("holding", "tracking") not in changes(log), "who takes over is entered with a blend"
    followed = [state for _, state in changes(log)[before:] if state in ("entering", "tracking")]
    assert followed[0] == "entering", "who takes over is entered with a blend"


def refuse_a_stranger(address: BusAddress, *robot: str) -> list[tuple[str, str]]:
    """A stock script begins to write beside a motion server of ours; return how the gate changed meanwhile."""
    far = FORMAT.default.copy()
    far[6 + 15] = 1.5
    with (
        logged(address) as log,
        G1Process(address, *robot),
        commander(address, "ours", "builtin:stand") as ours,
    ):
        wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")])
        followed = len(changes(log))
        with StockCommander(address, lambda _: far):
            wait_until(lambda: told_by_robot(log))
            wait_until(lambda: log.gate()["refused"] > 50)
            if lost := changes(log)[followed:]:
                return lost
            assert not log.events("command-handover")
        told = told_by_robot(log)[0].detail
        assert told["obeyed"] == f"ours (pid {ours.pid} on {HOST})"
        assert told["refused"] == ["a foreign writer"]
        assert "foreign" in told["writers"]
    assert np.abs(used(log)[:, 6 + 15] - far[6 + 15]).min() > 0.5, "never on the way there"
    return []


def refuse_ours(address: BusAddress, *robot: str) -> list[tuple[str, str]]:
    """A motion server of ours begins to write beside a stock script; return how the gate changed meanwhile."""
    with logged(address) as log, G1Process(address, *robot), StockCommander(address):
        wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")])
        followed = len(changes(log))
        with commander(address, "ours", "builtin:wave") as ours:
            wait_until(lambda: told_by_robot(log))
            wait_until(lambda: log.gate()["refused"] > 50)
            told = told_by_robot(log)[0].detail
            assert told["obeyed"] == "a foreign writer"
            assert told["refused"] == [f"ours (pid {ours.pid} on {HOST})"]
            if not (lost := changes(log)[followed:]):
                assert not log.events("command-handover")
            return lost
