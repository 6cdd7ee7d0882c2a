"""A station from its start to its end over many histories: real session and supervisor, children in virtual time."""

from __future__ import annotations

import itertools
import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from station.bus.client import Bus
from station.life.server import HEARTBEAT_S
from station.supervision import exit_policy as deaths
from station.supervision import runbook
from station.supervision.session import Session
from station.supervision.supervisor import _STOP_S, Supervisor
from tests.examples import some
from tests.supervision.place import Person
from tests.supervision.processes_in_virtual_time import FakeProcess, Processes, Script, processes_in
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network

SEEDS = some(range(60))
BOOK = """
runbook: t
robot: unitree_g1_with_hands
steps:
  - start: recorder
    ready_within: 10s
  - start: cues
    ready_within: 10s
  - start: motion
    with: {motion: "builtin:wave"}
    ready_within: 10s
"""
ORDER = ("recorder", "cues", "motion")
LATE_S = 0.3
"""The session looks ten times a second [s]."""


class Station:
    """A session in virtual time."""

    def __init__(self, clock: VirtualClock, processes: Processes, network: Network, folder: Path) -> None:
        self.clock, self.processes = clock, processes
        self.person, self.stop = Person(), threading.Event()
        self._network, self._folder = network, folder

    def run(self, for_s: float | None) -> int:
        file = self._folder / "book.yaml"
        file.write_text(BOOK)
        with Bus(self._network.address(), name="supervisor", timeout_s=1.0) as bus:
            supervisor = Supervisor(bus, self._folder / "logs")
            try:
                return Session(runbook.load(file), bus, supervisor, self.person, data=self._folder / "data").run(
                    self.stop, for_s=for_s
                )
            finally:
                supervisor.stop_all()

    def last(self, name: str) -> FakeProcess:
        return self.processes.of(name)[-1]


@contextmanager
def station(folder: Path, seed: int) -> Iterator[Station]:
    with VirtualClock(seed, late_ns=2_000_000) as clock:
        network = Network(clock, (20_000, 300_000))
        with processes_in(clock, network.address()) as processes:
            yield Station(clock, processes, network, folder)


@pytest.mark.parametrize("seed", SEEDS)
def test_servers_begin_in_their_order_end_in_reverse_and_none_is_left(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    with station(tmp_path, seed) as place:
        fails = rng.choice((None, None, None, *ORDER))
        for name in ORDER:
            script = Script(loads_s=rng.uniform(0.0, 3.0), dies_loading=name == fails,
                            ends_s=rng.choice((0.0, rng.uniform(0.0, 3.0), None)))  # fmt: skip
            place.processes.scripts[name] = lambda life, script=script: script  # type: ignore[misc]
        is_asked = rng.random() < 0.3
        if is_asked:
            at_ns = place.clock.monotonic_ns() + round(rng.uniform(0.0, 8.0) * 1e9)
            place.clock.call_at(at_ns, place.stop.set)
        began_s = place.clock.monotonic_s()
        code = place.run(rng.uniform(3.0, 6.0))
        told = f"seed {seed}"
        begun = [process for name in ORDER for process in place.processes.of(name) if process.go_s is not None]
        assert [process.go_s for process in begun] == sorted(process.go_s or 0.0 for process in begun), told
        assert [process.name for process in begun] == list(ORDER[: len(begun)]), f"none before its turn; {told}"
        if fails is not None and not is_asked:
            assert code == 1, told
            assert fails not in [process.name for process in begun], told
        elif len(begun) == len(ORDER):
            for earlier, later in itertools.pairwise(reversed(begun)):
                assert earlier.ended_s is not None
                assert later.asked_s is not None
                assert earlier.ended_s <= later.asked_s + 1e-6, f"one after the other, in reverse; {told}"
            is_deaf = any(process.script.ends_s is None for process in begun)
            assert (code == 1) == is_deaf, f"one that had to be killed is a failure; {told}"
        for process in place.processes.started:
            assert process.returncode is not None, f"{process.name} is left; {told}"
            if process.asked_s is not None and process.ended_s is not None:
                assert process.ended_s - process.asked_s <= _STOP_S + LATE_S, told
        assert place.clock.monotonic_s() - began_s < 30.0 + 3 * (_STOP_S + LATE_S), told


def test_one_that_lives_and_says_nothing_is_told_of_after_three_seconds_and_when_it_is_back(tmp_path: Path) -> None:
    with station(tmp_path, 1) as place:
        place.person.is_attended = True
        place.processes.scripts["cues"] = lambda life: Script(silent_after_s=4.0 if life == 0 else None)
        heard_s: list[float] = []
        report = place.person.report

        def note(text: str, severity: str = "info") -> None:
            if "has said nothing for 3 s" in text:
                heard_s.append(place.clock.monotonic_s())
                place.person.wants_restart = True
            report(text, severity)  # type: ignore[arg-type]

        place.person.report = note  # type: ignore[method-assign, assignment]
        assert place.run(15.0) == 0
    first, second = place.processes.of("cues")
    assert first.go_s is not None
    silent_s = heard_s[0] - first.go_s - 4.0
    assert deaths.SILENT_S - HEARTBEAT_S <= silent_s <= deaths.SILENT_S + LATE_S
    assert len(heard_s) == 1
    assert first.killed_s is not None
    assert second.restarts == 1
    assert place.person.heard("server-active server=cues")
    assert place.person.offered == ""


def test_a_recorder_that_dies_is_started_again_whoever_attends_and_a_motion_that_dies_ends_the_station(
    tmp_path: Path,
) -> None:
    with station(tmp_path, 1) as place:
        place.processes.scripts["recorder"] = lambda life: Script(lives_s=3.5 if life == 0 else None)
        place.processes.scripts["motion"] = lambda life: Script(lives_s=8.0, code=1)
        assert place.run(None) == 1
    assert len(place.processes.of("recorder")) == 2
    assert len(place.processes.of("motion")) == 1
    assert place.person.heard("error server 'motion' ended with code 1; its last words: ")
