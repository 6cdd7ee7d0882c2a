"""Restarts, their delays and the end, over thousands of deaths: the real supervisor, its children in virtual time."""

from __future__ import annotations

import os
import random
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from servers.motion import MotionConfig
from station.bus.client import Bus
from station.errors import NotReady
from station.life.event_feed import EventFeed
from station.life.restarts import Restarts
from station.supervision import supervisor as supervisors
from station.supervision.supervisor import Supervisor
from tests.examples import some
from tests.supervision.processes_in_virtual_time import FakeProcess, Processes, Script, processes_in
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network

SEEDS = some(range(40))
SHORT_LIFE_S = 3.0
DELAYS_S = (0.0, 0.25, 0.5, 1.0, 2.0)
"""Before the restarts after one short life, two in a row, and so on; after six it is given up."""
LATE_S = 0.1
"""The supervisor looks twenty times a second, and a line takes its time [s]."""
CONFIG = MotionConfig(motion="builtin:wave")


class Bench:
    """A supervisor whose children live in virtual time."""

    def __init__(self, clock: VirtualClock, network: Network, processes: Processes, folder: Path) -> None:
        self.clock, self.network, self.processes = clock, network, processes
        self.bus = Bus(network.address(), name="supervisor", timeout_s=1.0)
        self.supervisor = Supervisor(self.bus, folder / "logs")
        self.told = EventFeed(self.bus)

    def events(self, name: str, server: str) -> list[dict[str, object]]:
        return [e.detail for e in self._events if e.name == name and e.detail.get("server") == server]

    def run(self, seconds: float) -> None:
        self.clock.sleep(seconds)

    def close(self) -> None:
        self.supervisor.stop_all()
        self._events = list(self.told.pop())
        self.told.close()
        self.bus.close()


@contextmanager
def bench(folder: Path, seed: int) -> Iterator[Bench]:
    with VirtualClock(seed, late_ns=2_000_000) as clock:
        network = Network(clock, (20_000, 300_000))
        with processes_in(clock, network.address()) as processes:
            made = Bench(clock, network, processes, folder)
            try:
                yield made
            finally:
                made.close()


def random_life(rng: random.Random) -> Script:
    """Return a life that is short, or longer than those that count as short, or without an end."""
    lives_s = rng.choice((0.0, rng.uniform(0.0, 2.0), rng.uniform(0.0, 2.0), rng.uniform(3.5, 6.0), None))
    code = rng.choice((1, 1, -signal.SIGKILL, -signal.SIGSEGV, 0, 2)) if rng.random() < 0.2 else 1
    return Script(loads_s=rng.uniform(0.05, 0.9), lives_s=lives_s, code=code, ends_s=rng.choice((0.0, 0.5, None)),
                  dies_loading=rng.random() < 0.1)  # fmt: skip


def short_lives(lives: list[FakeProcess]) -> int:
    """Count the short lives in a row at the end of some lives."""
    count = 0
    for life in lives:
        assert life.ended_s is not None
        count = count + 1 if life.ended_s - life.started_s < SHORT_LIFE_S - LATE_S else 0
    return count


@pytest.mark.parametrize("seed", SEEDS)
def test_whatever_dies_how_often_it_comes_back_in_time_and_never_after_it_was_given_up(
    tmp_path: Path, seed: int
) -> None:
    play(seed, tmp_path)


def play(seed: int, tmp_path: Path) -> None:
    """Run a trial and judge it."""
    rng = random.Random(seed)
    names = [f"s{number}" for number in range(rng.randint(1, 3))]
    with bench(tmp_path, seed) as station:
        for name in names:
            scripts = [random_life(random.Random(f"{seed} {name} {life}")) for life in range(40)]
            station.processes.scripts[name] = lambda life, scripts=scripts: scripts[life]  # type: ignore[misc]
            station.supervisor.spawn(name, CONFIG, server="motion", restarts=Restarts())
        active = []
        for name in names:
            try:
                station.supervisor.wait_for(name, "inactive", 5.0)
                station.supervisor.activate(name)
                active.append(name)
            except NotReady:  # it died while it loaded, or another one has ended meanwhile
                assert any(process.returncode is not None for process in station.processes.started)
        station.run(rng.uniform(5.0, 40.0))
        over_s = station.clock.monotonic_s()
    for name in names:
        told = f"seed {seed}, {name}"
        lives = station.processes.of(name)
        if name not in active:
            assert len(lives) == 1, f"one that never was active has a fault that a restart does not mend; {told}"
            continue
        assert [life.restarts for life in lives] == list(range(len(lives))), told
        for number, life in enumerate(lives):
            assert life.ended_s is not None, f"left behind; {told}"
            assert life.started_s <= over_s + LATE_S, f"started at the end; {told}"
            has_followed, is_asked = number + 1 < len(lives), life.ended_s > over_s or life.asked_s is not None
            if has_followed:
                before, after_s = short_lives(lives[: number + 1]), lives[number + 1].started_s - life.ended_s
                assert life.returncode not in (0, 2), f"it had ended as it should, or will fail alike; {told}"
                assert before < 6, f"given up; {told}"
                assert DELAYS_S[max(0, before - 1)] <= after_s + 1e-6, f"{before} short lives; {told}"
                assert after_s <= DELAYS_S[max(0, before - 1)] + LATE_S, f"{before} short lives; {told}"
            elif not is_asked and life.returncode not in (0, 2) and short_lives(lives) < 6:
                waits_s = DELAYS_S[max(0, short_lives(lives) - 1)]
                assert over_s - life.ended_s <= waits_s + LATE_S, f"it was forgotten; {told}"
            if life.go_s is not None and number:
                assert life.go_s - life.started_s <= life.script.loads_s + LATE_S, f"a restart waits for nobody; {told}"


@pytest.mark.parametrize("seed", SEEDS)
def test_the_end_asks_all_at_once_and_kills_whoever_is_deaf_to_it(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    names = [f"s{number}" for number in range(rng.randint(1, 4))]
    before = len(os.listdir("/proc/self/fd"))
    with bench(tmp_path, seed) as station:
        for name in names:
            script = Script(
                ends_s=rng.choice((None, rng.uniform(0.0, 4.5), rng.uniform(5.5, 8.0))), loads_s=rng.uniform(0.0, 1.0)
            )
            station.processes.scripts[name] = lambda life, script=script: script  # type: ignore[misc]
            station.supervisor.spawn(name, CONFIG, server="motion")
        for name in names[: rng.randint(0, len(names))]:
            station.supervisor.wait_for(name, "inactive", 5.0)
            station.supervisor.activate(name)
        station.run(rng.uniform(0.0, 3.0))
        began_s = station.clock.monotonic_s()
        station.supervisor.stop_all()
        for process in station.processes.started:
            told = f"seed {seed}, {process.name}"
            assert process.asked_s == pytest.approx(began_s, abs=0.01), f"all at once; {told}"
            assert process.ended_s is not None, told
            assert process.ended_s - began_s <= supervisors._HURRY_S + LATE_S, told
            is_deaf = process.script.ends_s is None
            takes_s = 0.0 if process.script.ends_s is None or process.go_s is None else process.script.ends_s
            assert (process.killed_s is not None) == (is_deaf or takes_s > supervisors._HURRY_S), told
        assert station.supervisor.children == {}
    assert len(os.listdir("/proc/self/fd")) == before, "pipes are let go of"


def test_one_that_is_stopped_by_name_is_asked_given_its_time_and_then_killed(tmp_path: Path) -> None:
    with bench(tmp_path, 1) as station:
        station.processes.scripts = {
            "good": lambda _: Script(ends_s=supervisors._STOP_S - 1.0), "deaf": lambda _: Script(ends_s=None)
        }  # fmt: skip
        for name in ("good", "deaf"):
            station.supervisor.spawn(name, CONFIG, server="motion", restarts=Restarts())
            station.supervisor.wait_for(name, "inactive", 5.0)
            station.supervisor.activate(name)
            station.supervisor.wait_for(name, "active", 5.0)
        assert station.supervisor.stop("good") == 0
        assert station.supervisor.stop("deaf") == -signal.SIGKILL
        (good,), (deaf,) = station.processes.of("good"), station.processes.of("deaf")
        assert good.killed_s is None
        assert deaf.asked_s is not None
        assert deaf.killed_s == pytest.approx(deaf.asked_s + supervisors._STOP_S, abs=LATE_S)
        station.run(10.0)
        assert len(station.processes.started) == 2, "whoever was stopped is not started again"


def test_a_child_that_never_gets_ready_is_told_of_when_its_time_is_over(tmp_path: Path) -> None:
    with bench(tmp_path, 1) as station:
        station.processes.scripts["slow"] = lambda _: Script(loads_s=100.0)
        station.supervisor.spawn("slow", CONFIG, server="motion")
        began_s = station.clock.monotonic_s()
        (station.supervisor._folder / "slow.log").write_text("loading a large thing\n")
        with pytest.raises(NotReady, match=r"'slow' is unconfigured, not inactive, after 60 s: loading a large thing"):
            station.supervisor.wait_for("slow", "inactive", 60.0)
        assert station.clock.monotonic_s() - began_s == pytest.approx(60.0, abs=LATE_S)


def test_a_server_is_given_up_after_six_short_lives_and_both_are_told(tmp_path: Path) -> None:
    with bench(tmp_path, 1) as station:
        station.processes.scripts["ill"] = lambda _: Script(lives_s=0.5, code=-signal.SIGSEGV)
        station.supervisor.spawn("ill", CONFIG, server="motion", restarts=Restarts())
        station.supervisor.wait_for("ill", "inactive", 5.0)
        station.supervisor.activate("ill")
        station.run(20.0)
        assert len(station.processes.started) == 6
        assert station.supervisor.ended() == {"ill": -signal.SIGSEGV}
        station.supervisor.start_again("ill")
        station.run(0.2)
        assert len(station.processes.started) == 7, "a person may start it all the same"
    assert [event["restarts"] for event in station.events("server-restarted", "ill")] == [1, 2, 3, 4, 5]
    assert [event["delay_s"] for event in station.events("server-restarted", "ill")] == [0.0, 0.25, 0.5, 1.0, 2.0]
    (given_up,) = station.events("server-given-up", "ill")
    assert given_up["reason"] == "was killed by SIGSEGV; started again 5 times, and it dies within 3 s each time"
