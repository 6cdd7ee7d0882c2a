"""Two commanders on one key, as real processes: the robot follows one, and everybody hears of both."""

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
from station.control.slew import LONGEST_TICK_S
from station.life.events import Event, decode
from station.protocols import Floats
from tests.faults.bus_station import frozen
from tests.lateness import TooLate, Waits, in_time
from tests.servers.g1_station import FORM, PATIENT, ROBOT, G1Process, Log, StockCommander, logged
from tests.waiting import wait_until

COMMAND = FORM.key
SOON = 10  # writes of a 50 Hz commander in 200 ms
PERIOD_S = 0.02
PATIENT_S = 1.0  # as long without a command the gate of a patient robot holds
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
    assert (np.abs(np.diff(used(log), axis=0)) <= FORM.rate * LONGEST_TICK_S + 1e-9).all()


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


def expect_to_be_followed_alone(log: Log, followed: int, waits: Waits) -> None:
    """Nobody else was, and the gate has not changed but where he who was followed fell silent: the machine was late."""
    if lost := changes(log)[followed:]:
        raise TooLate(f"the commands of who is obeyed: {lost}", PATIENT_S, waits.seconds())
    assert not log.events("command-handover")


def test_the_second_of_two_motion_servers_is_refused_and_takes_over_when_the_first_is_killed(
    bus_server: BusAddress,
) -> None:
    in_time(lambda: refuse_the_second(bus_server))


def refuse_the_second(address: BusAddress) -> None:
    with (
        logged(address) as log,
        G1Process(address, *PATIENT),
        commander(address, "first", "builtin:stand") as first,
    ):
        wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")])
        waits, followed = Waits(), len(changes(log))
        with commander(address, "second", "builtin:wave") as second:
            wait_until(lambda: told_by_robot(log))
            waited_s = waits.seconds()
            told = told_by_robot(log)[0].detail
            wait_until(lambda: len(writes_of(log, "second")) > 150)
            heard = heard_before_told(log, "second")
            assert told["obeyed"] == f"first (pid {first.pid} on {HOST})"
            assert told["refused"] == [f"second (pid {second.pid} on {HOST})"]
            assert [source.split(".")[:2] for source in told["writers"]] == [
                ["first", str(first.pid)], ["second", str(second.pid)]
            ]  # fmt: skip
            wait_until(lambda: log.gate()["refused"] > 100)
            newest = used_while_tracking(log)
            firsts = {write.value for write in writes_of(log, "first")}
            obeyed = [codec.parse_json_vector(value) for value in firsts if value is not None]
            expect_to_be_followed_alone(log, followed, waits)
            for vector in newest:
                assert min(np.abs(vector - other).max() for other in obeyed) < 1e-9
            expect_handover(log, first, second)
    expect_no_kick(log)
    assert not log.events("fall")
    if heard > SOON:
        raise TooLate(f"told of the second after {heard} of its writes", (heard - SOON) * PERIOD_S, waited_s)


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


def test_a_robots_server_that_stood_still_itself_goes_on_obeying_the_first(bus_server: BusAddress) -> None:
    in_time(lambda: stand_still(bus_server))


def stand_still(address: BusAddress) -> None:
    with (
        logged(address) as log,
        G1Process(address, *PATIENT) as robot,
        commander(address, "first", "builtin:stand") as first,
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        with commander(address, "second", "builtin:wave"):
            wait_until(lambda: told_by_robot(log))
            waits, written = Waits(), len(writes_of(log, "first"))
            with frozen(robot.process.pid):
                wait_until(lambda: len(writes_of(log, "first")) > written + 130)  # longer than it may be silent
                first.send_signal(signal.SIGSTOP)
                count = len(writes_of(log, "second"))
                wait_until(lambda: len(writes_of(log, "second")) > count)  # the newest write that the robot finds
            ticks = len(log.states())
            wait_until(lambda: len(log.states()) > ticks + 2)
            first.send_signal(signal.SIGCONT)
            wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")] and len(log.states()) > ticks + 50)
            if log.events("command-handover"):
                raise TooLate("a write of who is obeyed", PATIENT_S, waits.seconds())


def test_a_stock_script_beside_our_motion_server_is_refused_and_called_foreign(bus_server: BusAddress) -> None:
    in_time(lambda: refuse_a_stranger(bus_server))


def refuse_a_stranger(address: BusAddress) -> None:
    far = FORM.default.copy()
    far[6 + 15] = 1.5
    with (
        logged(address) as log,
        G1Process(address, *PATIENT),
        commander(address, "ours", "builtin:stand") as ours,
    ):
        wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")])
        waits, followed = Waits(), len(changes(log))
        with StockCommander(address, lambda _: far):
            wait_until(lambda: told_by_robot(log))
            wait_until(lambda: log.gate()["refused"] > 50)
            expect_to_be_followed_alone(log, followed, waits)
        told = told_by_robot(log)[0].detail
        assert told["obeyed"] == f"ours (pid {ours.pid} on {HOST})"
        assert told["refused"] == ["a foreign writer"]
        assert "foreign" in told["writers"]
    assert np.abs(used(log)[:, 6 + 15] - far[6 + 15]).min() > 0.5, "never on the way there"


def test_in_lock_step_only_the_commands_of_who_is_obeyed_are_used(bus_server: BusAddress) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *PATIENT, "pace=command"),
        commander(bus_server, "ours", "builtin:walk-forward", "pace=state"),
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        with StockCommander(bus_server):
            wait_until(lambda: told_by_robot(log))
            wait_until(lambda: log.gate()["refused"] > 20)
            timing = [codec.parse_json_vector(value) for value in log.values(keys.policy_timing(ROBOT))]
    sequence = np.array(timing)[:, 1]
    assert (sequence > 0).all(), "a foreign command has no number"
    assert (np.diff(sequence) >= 0).all()
    assert not log.events("command-handover")


def test_our_motion_server_beside_a_stock_script_is_refused(bus_server: BusAddress) -> None:
    in_time(lambda: refuse_ours(bus_server))


def refuse_ours(address: BusAddress) -> None:
    with logged(address) as log, G1Process(address, *PATIENT), StockCommander(address):
        wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")])
        waits, followed = Waits(), len(changes(log))
        with commander(address, "ours", "builtin:wave") as ours:
            wait_until(lambda: told_by_robot(log))
            wait_until(lambda: log.gate()["refused"] > 50)
            told = told_by_robot(log)[0].detail
            assert told["obeyed"] == "a foreign writer"
            assert told["refused"] == [f"ours (pid {ours.pid} on {HOST})"]
            expect_to_be_followed_alone(log, followed, waits)


def test_whoever_begins_last_is_obeyed_where_that_is_configured(bus_server: BusAddress) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *PATIENT, "gate.rivals=newest"),
        commander(bus_server, "first", "builtin:stand"),
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        with commander(bus_server, "second", "builtin:wave") as second:
            wait_until(lambda: log.events("command-handover"))
            wait_until(lambda: log.events("second-writer"))
            wait_until(lambda: log.gate()["refused"] > 50)
            (handover,) = log.events("command-handover")
            assert handover.detail["obeyed"] == f"second (pid {second.pid} on {HOST})"
            assert handover.detail["reason"] == "it began to write last"
    assert ("tracking", "entering") in changes(log)
    expect_no_kick(log)


def test_a_stock_script_in_place_of_our_motion_server_is_followed_and_no_rival(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *PATIENT):
        with commander(bus_server, "ours", "builtin:stand") as ours:
            wait_until(lambda: log.gate()["state"] == "tracking")
            ours.send_signal(signal.SIGTERM)
            assert ours.wait(30) == 0
        with StockCommander(bus_server):
            wait_until(lambda: log.events("command-handover"))
            wait_until(lambda: log.gate()["state"] == "tracking")
        (handover,) = log.events("command-handover")
        assert handover.detail["obeyed"] == "a foreign writer"
    assert not log.events("second-writer")
