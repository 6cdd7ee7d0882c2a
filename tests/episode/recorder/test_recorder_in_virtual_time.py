"""A recorder through faults of its bus, in virtual time: what it answers, what it writes, and when it gives up.

The recorder's server, a robot that counts, and an operator who asks, each a process; the files are real. The bus is
polled, since the one in virtual time has no replication.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from servers import recorder
from servers.recorder import RecorderConfig
from station.bus import keys
from station.bus.client import Bus
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote
from station.episode.storage.left_open import left_open
from station.episode.storage.manifest import Manifest, load_manifest
from station.episode.storage.request import Action, RecordAnswer
from station.errors import StationError
from station.life.server import Life, ServerKind
from station.life.serving import serve
from tests.examples import some
from tests.virtual.clock import Process, VirtualClock
from tests.virtual.network import Network
from tests.virtual.written import Log

SEEDS = some(range(12))
SECONDS = 12.0
RESUME_S = 5.0
PATIENCE_S = 4.0
"""Of whoever asks [s]."""
COUNT = "count"
PERIOD_S = 0.1
_FIELDS: dict[str, dict[str, Any]] = {"start": {"task": "t"}, "mark": {"label": "x"}}
LOOK_S = 0.05  # the tap's, and what a line takes


class Asked(NamedTuple):
    """What was asked of the recorder, and what came of it; instants in [s]."""

    action: Action
    at_s: float
    answered_s: float
    answer: RecordAnswer | None


class Station:
    """A recorder, a robot that counts and an operator."""

    def __init__(self, clock: VirtualClock, data: Path) -> None:
        self.clock, self.network, self.data = clock, Network(clock, (20_000, 300_000)), data
        self.log = Log(self.network)
        self.asked: list[Asked] = []
        self.code: int | None = None
        self._life: Life | None = None
        self.robot = clock.spawn(self._count, "robot")
        self.recorder = clock.spawn(self._record, "recorder")
        clock.sleep(0.5)

    def ask(self, action: Action, **fields: Any) -> Process:
        """Ask for something from a process of its own; see `asked`."""

        def run() -> None:
            began_s, answer = self.clock.monotonic_s(), None
            try:
                with Bus(self.network.address(), name="operator", timeout_s=1.0) as bus:
                    answer = remote.ask(bus, action, timeout_s=PATIENCE_S, **fields)
            except StationError:
                pass
            self.asked.append(Asked(action, began_s, self.clock.monotonic_s(), answer))

        return self.clock.spawn(run, "operator")

    def ask_and_wait(self, action: Action, **fields: Any) -> RecordAnswer | None:
        process = self.ask(action, **fields)
        while self.clock.is_running(process):
            self.clock.sleep(0.01)
        return self.asked[-1].answer

    def stop(self) -> None:
        assert self._life is not None
        self._life.stop_event.set()
        end_s = self.clock.monotonic_s() + 20.0
        while self.clock.is_running(self.recorder) and self.clock.monotonic_s() < end_s:
            self.clock.sleep(0.05)
        assert self.code is not None, f"the recorder does not end (seed {self.clock.seed})"

    def manifests(self) -> list[Manifest]:
        return [load_manifest(folder) for folder in sorted(self.data.glob("*/*/"))]

    def counted(self, manifest: Manifest) -> list[int]:
        """Return what an episode holds of the robot's count."""
        folder = next(self.data.glob(f"*/{manifest.episode_id}"))
        return [int(message.data) for message in open_episode(folder).messages([COUNT])]

    def _record(self) -> None:
        def main(config: RecorderConfig, life: Life) -> int:
            self._life = life
            return recorder.main(config, life)

        kind = ServerKind(name="recorder", role="recorder", summary="", config=RecorderConfig, main=main,
                          bus_timeout_s=1.0)  # fmt: skip
        config = RecorderConfig(data=self.data, backend="poll", flush_s=2.0, min_free_mb=0.0, resume_s=RESUME_S)
        self.code = serve(kind, config, address=self.network.address())

    def _count(self) -> None:
        with Bus(self.network.address(), name="robot") as bus:
            number = 0
            while True:
                number += 1
                bus.publish({COUNT: b"%d" % number})
                self.clock.sleep(PERIOD_S)


@contextmanager
def station(tmp_path: Path, seed: int) -> Iterator[Station]:
    with pytest.MonkeyPatch.context() as patch, VirtualClock(seed, late_ns=1_000_000) as clock:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # of the recorders' locks
        patch.setattr("sys.setswitchinterval", lambda seconds: None)  # of the process that runs all tests
        yield Station(clock, tmp_path / "data")


@pytest.mark.parametrize("down_s", [0.3, 2.0, 4.5, 6.0, 12.0])
def test_an_episode_waits_for_a_bus_that_comes_back_and_ends_where_that_takes_too_long(
    tmp_path: Path, down_s: float
) -> None:
    with station(tmp_path, 1) as place:
        assert place.ask_and_wait("start", task="t") is not None
        began_s = place.clock.monotonic_s()
        place.clock.sleep(3.0)
        place.network.restart_server(down_s)
        place.clock.sleep(down_s + 3.0)
        answer = place.ask_and_wait("stop")
        place.stop()
    (manifest,) = place.manifests()
    if down_s < RESUME_S:
        assert answer is not None
        assert manifest.recorder.ended_by == "stop"
        (hole,) = manifest.holes
        assert hole.from_s == pytest.approx(3.0, abs=0.2)
        assert hole.to_s == pytest.approx(3.0 + down_s, abs=0.2)
    else:
        assert answer is None, "there is nothing to stop"
        assert manifest.recorder.ended_by == "bus-lost"
        assert manifest.timing.duration_s == pytest.approx(3.0 + RESUME_S, abs=0.3)
    assert began_s < place.clock.monotonic_s()


def test_it_says_what_it_does_twice_a_second_and_nothing_when_it_has_ended(tmp_path: Path) -> None:
    with station(tmp_path, 1) as place:
        place.clock.sleep(5.0)
        said = [write.at_s for write in place.log.of(keys.RECORDER)]
        assert all(0.45 < after - before < 0.6 for before, after in itertools.pairwise(said[1:]))
        place.stop()
        assert keys.RECORDER.encode() not in place.network.server.keys(0)


def test_marks_bear_the_time_at_which_they_were_asked_for_and_stand_on_the_disk_a_second_later(tmp_path: Path) -> None:
    with station(tmp_path, 1) as place:
        start = place.ask_and_wait("start", task="t")
        assert start is not None
        began_s, asked_s = place.clock.monotonic_s(), []
        for label in ("a", "b", "c"):
            place.clock.sleep(2.0)
            asked_s.append(place.clock.monotonic_s() - began_s)
            assert place.ask_and_wait("mark", label=label) is not None
        place.clock.sleep(1.5)
        assert [mark.label for mark in load_manifest(Path(start.path or "")).marks] == ["a", "b", "c"], "it goes on"
        assert place.ask_and_wait("stop") is not None
        place.stop()
    (manifest,) = place.manifests()
    for mark, at_s in zip(manifest.marks, asked_s, strict=True):
        assert mark.at_s == pytest.approx(at_s, abs=0.2)


def spoil(place: Station, rng: random.Random) -> str:
    """Do something to the recorder's bus, or to the recorder; return what."""
    seconds = rng.choice((0.05, 0.4, 1.5))
    faults: dict[str, Callable[[], None]] = {
        "freeze recorder": lambda: place.clock.freeze(place.recorder, seconds),
        "freeze robot": lambda: place.clock.freeze(place.robot, seconds),
        "freeze line": lambda: place.network.freeze(place.recorder, seconds),
        "cut line": lambda: place.network.cut(place.recorder),
        "freeze bus": lambda: place.network.freeze_server(seconds),
        "restart bus": lambda: place.network.restart_server(rng.choice((0.1, 1.0))),
    }
    name = rng.choice(list(faults))
    faults[name]()
    return name


@pytest.mark.parametrize("seed", SEEDS)
def test_whatever_befalls_it_each_start_is_one_whole_episode_and_what_it_lacks_is_told(
    tmp_path: Path, seed: int
) -> None:
    play(seed, tmp_path)


def play(seed: int, tmp_path: Path) -> None:
    """Run a trial and judge it."""
    rng = random.Random(seed)
    with station(tmp_path, seed) as place:
        end_s = place.clock.monotonic_s() + SECONDS
        while place.clock.monotonic_s() < end_s:
            place.clock.sleep(rng.choice((0.02, 0.3, 1.0)))
            if rng.random() < 0.6:
                action: Action = rng.choice(("start", "start", "stop", "mark", "discard"))
                place.ask(
                    action, **({"task": "t"} if action == "start" else {"label": "x"} if action == "mark" else {})
                )
            else:
                spoil(place, rng)
        place.clock.sleep(PATIENCE_S + 3.0)
        place.stop()
    told = f"seed {seed}"
    assert place.code == 0, told
    assert not left_open(place.data), told
    manifests = {manifest.episode_id: manifest for manifest in place.manifests()}
    started = [asked.answer.episode_id for asked in place.asked if asked.action == "start" and asked.answer]
    assert len(set(started)) == len(started), f"one start, one episode; {told}"
    assert set(started) <= set(manifests), f"every start that was answered is an episode; {told}"
    for episode_id, manifest in manifests.items():
        of_this = f"{told}, {episode_id}"
        assert manifest.state == "finished", of_this
        assert manifest.recorder.ended_by in ("stop", "discard", "bus-lost", "shutdown"), of_this
        numbers = place.counted(manifest)
        assert numbers == sorted(set(numbers)), f"each write once, in order; {of_this}"
        lost = sum(stream.lost for stream in manifest.streams if stream.key == COUNT)
        if numbers:
            assert numbers[-1] - numbers[0] + 1 == len(numbers) + lost, f"what is not there is counted; {of_this}"
        holes = manifest.holes
        assert all(hole.from_s <= hole.to_s for hole in holes), of_this
        marks = [mark.at_s for mark in manifest.marks if mark.label == "x"]
        assert marks == sorted(marks), of_this
        assert all(0.0 <= at_s <= manifest.timing.duration_s + LOOK_S for at_s in marks), of_this
    for asked in place.asked:
        assert asked.answered_s - asked.at_s < PATIENCE_S + 3.0, f"{asked}; {told}"
