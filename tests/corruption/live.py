"""Stations in which a process is killed, stopped, paused or slowed while they record: does a verdict tell it?"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import yaml

from tests.cli.running import Home, Running
from tests.corruption import stations
from tests.corruption.files import ONE_S
from tests.corruption.judging import Verdict, cell, judge
from tests.corruption.parts import Harm
from tests.waiting import is_running, wait_until

PAUSE_S = 1.5
SLOW_S = 3.0
_BEFORE_S, _AFTER_S = (3.0, 5.0), 5.0
_READY_S = 120.0


def kill(pid: int) -> None:
    """``kill -9``."""
    os.kill(pid, signal.SIGKILL)


def stop(pid: int) -> None:
    """It stands still, to the end."""
    os.kill(pid, signal.SIGSTOP)


def pause(pid: int) -> None:
    """It stands still for a while."""
    os.kill(pid, signal.SIGSTOP)
    time.sleep(PAUSE_S)
    os.kill(pid, signal.SIGCONT)


def slow(pid: int) -> None:
    """It gets a third of its time, in slices."""
    end_s = time.monotonic() + SLOW_S
    while time.monotonic() < end_s:
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.2)
        os.kill(pid, signal.SIGCONT)
        time.sleep(0.1)


FAULTS: tuple[Callable[[int], None], ...] = (kill, stop, pause, slow)


@dataclass(frozen=True)
class Trial:
    """Which process of which station is broken, and how."""

    kind: stations.Kind
    server: str
    fault: Callable[[int], None]


def trials(count: int, seed: int) -> list[Trial]:
    """Return so many, chosen at random: each process of each station about as often as the others, by each fault."""
    walk, operator = stations.KINDS["walk"], stations.KINDS["operator"]
    places = [(walk, "g1"), (walk, "motion"), (operator, "head"), (operator, "left_wrist"), (operator, "g1"),
              (operator, "pico"), (operator, "teleop")]  # fmt: skip
    if stations.HAS_ARMS:
        places += [(stations.KINDS["arm"], name) for name in ("kassow", "spacemouse", "teleop")]
    chance = Random(seed)
    found: list[Trial] = []
    while len(found) < count:
        chance.shuffle(places)
        shift = chance.randrange(len(FAULTS))
        found += [
            Trial(kind, server, FAULTS[(shift + number) % len(FAULTS)]) for number, (kind, server) in enumerate(places)
        ]
    return found[:count]


def run(count: int, work: Path, seed: int) -> int:
    """Break so many stations, print a line of each; return 1 if one was not told."""
    told = 0
    chance = Random(seed)
    for number, trial in enumerate(trials(count, seed), 1):
        what = f"{number:3} {trial.kind.name:<9} {trial.fault.__name__:<6} {trial.server:<11}"
        folder = work / "live" / f"{number:03d}-{trial.kind.name}-{trial.fault.__name__}-{trial.server}"
        try:
            at_ns = _broken(trial, folder, chance.uniform(*_BEFORE_S))
        except (RuntimeError, AssertionError) as error:
            _print(f"{what} NO EPISODE: {error}\n")
            continue
        found = judge(folder, is_audited=False)
        harm = _harm(folder, trial.server, at_ns)
        how = cell(found, Verdict("good"), harm)
        told += how in ("full", "key", "told")
        _print(f"{what} at {harm.from_s:.1f} s: {how:<6} {found.verdict}\n")
        for reason in found.reasons:
            _print(f"      {reason['verdict']} {reason['rule']}: {reason['text']}\n")
    _print(f"{told} of {count} told\n")
    return 0 if told == count else 1


def _broken(trial: Trial, into: Path, after_s: float) -> int:
    """Record an episode, break a process in it, and go on for some seconds; return when it was broken [ns]."""
    with stations.station_home() as (home, files), home.running(*trial.kind.arguments(files)) as station:
        pid = _pid(home, station, trial.server)
        time.sleep(after_s)
        at_ns = time.time_ns()
        try:
            trial.fault(pid)
            end_s = time.monotonic() + _AFTER_S
            while time.monotonic() < end_s and station.process.poll() is None:
                time.sleep(0.05)
            with contextlib.suppress(ProcessLookupError):
                station.interrupt()
            station.finish(_READY_S)
        finally:
            if is_running(pid):  # it was stopped, and nobody could take it down
                os.kill(pid, signal.SIGKILL)
        stations.take_episode(home, into, station.text)
        return at_ns


def _pid(home: Home, station: Running, server: str) -> int:
    """Wait until the whole station runs and records; return the process of a server."""

    def is_ready() -> bool:
        if station.process.poll() is not None:
            raise RuntimeError(f"the station ended:\n{station.text[-2000:]}")
        if not home.bus_is_there() or not any(home.data.glob("*/*")):
            return False
        last = "teleop" if "teleop" in home.pids() else "motion"
        return {server, last} <= home.pids().keys()

    wait_until(is_ready, _READY_S)
    return home.pids()[server]


def _harm(folder: Path, server: str, at_ns: int) -> Harm:
    """Return what was harmed: the server, its camera, and every key that it writes."""
    document = yaml.safe_load((folder / "manifest.yaml").read_text(encoding="utf-8"))
    keys = [row["key"] for row in document["streams"] if row["writer"] == server]
    at_s = (at_ns - document["timing"]["anchor"]["wall_ns"]) / ONE_S
    return Harm((server, *keys), at_s)


def _print(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()
