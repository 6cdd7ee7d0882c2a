"""Killed while it closes an episode on a disk that hangs, when the next one has begun: both are recorded, each once."""

from __future__ import annotations

import fcntl
import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.cli.main import cli
from station.episode.reading.reader import open_episode
from station.episode.storage import layout
from station.episode.storage.file_hashes import measure
from station.episode.storage.left_open import left_open
from station.episode.storage.manifest import load_manifest
from tests.episode.recorder.killed_recorder import CLOSING, HELD, Client, Orders, Recorder
from tests.waiting import wait_until

CLOSING_STEPS = 11  # operations on files while an episode is closed; behind them nothing is left of its resume point
LATER = 40  # operations on files that a recovery takes, and more


class Trial:
    """Recorders, one after the other, on one bus and one data folder."""

    def __init__(self, address: BusAddress, folder: Path, bus: Bus) -> None:
        self.address, self.folder, self.client = address, folder, Client(bus)

    def life(self, orders: Orders) -> Recorder:
        """Start a recorder."""
        return Recorder(self.address, self.folder, orders)

    def end_a_while_it_hangs(self, orders: Orders) -> tuple[Recorder, int]:
        """Have episode `a` recorded and its end asked for; return the recorder, and what was written until then."""
        recorder, client = self.life(orders), self.client
        wait_until(lambda: client.state(recorder) is not None)
        client.ask("start", task="a")
        client.write(20)
        (self.folder / CLOSING).touch()
        client.request("stop", "stop a")
        in_a = client.written
        wait_until(lambda: (self.folder / HELD).exists() or client.answered("stop a"))
        client.write(10)
        return recorder, in_a

    def is_in(self, task: str, recorder: Recorder) -> bool:
        """Whether a recorder says that it records an episode of a task."""
        state = self.client.state(recorder)
        return state is not None and state.path is not None and Path(state.path).parent.name == task

    def assert_whole(self, spans: dict[str, tuple[int, int]]) -> None:
        """Each episode is there once, closed, and holds at least its span, every write once."""
        data = self.folder / "data"
        assert sorted(folder.parent.name for folder in data.glob("*/*/")) == sorted(spans), "each once, and no other"
        assert left_open(data) == []
        for folder in data.glob("*/*/"):
            first, last = spans[folder.parent.name]
            numbers = [int(message.data) for message in open_episode(folder).messages(["own"])]
            assert numbers == list(range(numbers[0], last + 1)), "once, in order, to the end"
            assert numbers[0] <= first
            manifest = load_manifest(folder)
            assert (manifest.state, manifest.recorder.ended_by, manifest.holes) == ("finished", "stop", [])
            assert manifest.files == measure(folder), "whoever closed it wrote what its files are"
            assert {file.name for file in folder.iterdir()} == {"manifest.yaml", "signals.mcap"}


@pytest.fixture
def trial(bus_server: BusAddress, tmp_path: Path) -> Iterator[Trial]:
    with Bus(bus_server, name="g1", timeout_s=5.0) as bus:
        yield Trial(bus_server, tmp_path, bus)


def b_begins_and_recorders_die(trial: Trial, *lives: Orders) -> None:
    """Have `b` begun while `a` is being closed and recorders die as ordered; the last one lives to the end.

    Where two died before anything of `b` was on the disk, it may begin as late as its start is answered.
    """
    client = trial.client
    recorder, in_a = trial.end_a_while_it_hangs(lives[0])
    client.request("start", "start b", task="b")
    client.write(10)
    wait_until(lambda: recorder.is_dead() or client.answered("start b"))
    first = in_a + 11 if len(lives) == 1 or client.answered("start b") else None
    recorder.end()
    for orders in (*lives[1:], Orders()):
        recorder = trial.life(orders)
        wait_until(lambda recorder=recorder: recorder.is_dead() or trial.is_in("b", recorder))  # type: ignore[misc]
        client.write(5)
        if orders != Orders():
            recorder.end()
    client.write(1)
    first = first or client.written
    assert client.ask("stop").ok
    recorder.end(signal.SIGTERM)
    trial.assert_whole({"a": (1, in_a), "b": (first, client.written)})


@pytest.mark.parametrize("hangs", range(0, CLOSING_STEPS, 2))
@pytest.mark.parametrize("kills", [0, 3, 8, None])
def test_both_are_recorded_once(trial: Trial, hangs: int, kills: int | None) -> None:
    b_begins_and_recorders_die(trial, Orders(hangs=hangs, kills=kills))


@pytest.mark.parametrize("seed", range(6))
def test_also_where_the_ones_that_recover_are_killed(trial: Trial, seed: int) -> None:
    chance = random.Random(seed)
    first = Orders(hangs=chance.randrange(CLOSING_STEPS), kills=chance.choice([None, *range(12)]))
    b_begins_and_recorders_die(trial, first, *(Orders(kills=chance.randrange(LATER), of=("a", "b")) for _ in range(2)))


@pytest.mark.parametrize("hangs", [1, 4])
def test_what_was_recorded_and_closed_meanwhile_is_not_recorded_again(trial: Trial, hangs: int) -> None:
    client = trial.client
    recorder, in_a = trial.end_a_while_it_hangs(Orders(hangs=hangs))
    client.ask("start", task="b")
    client.write(10)
    client.ask("stop")
    in_b = client.written
    recorder.end()
    client.write(5)
    recorder = trial.life(Orders())
    wait_until(lambda: client.state(recorder) is not None)
    client.write(5)
    before_c = client.written
    client.ask("start", task="c")
    client.write(5)
    client.ask("stop")
    recorder.end(signal.SIGTERM)
    trial.assert_whole({"a": (1, in_a), "b": (in_a + 11, in_b), "c": (before_c + 1, client.written)})


@pytest.mark.parametrize("hangs", range(2, 10))
def test_one_that_was_ended_before_it_could_be_begun_is_recorded(trial: Trial, hangs: int) -> None:
    client, recorder = trial.client, trial.life(Orders(hangs=hangs))
    wait_until(lambda: client.state(recorder) is not None)
    client.ask("start", task="z")
    client.write(10)
    (trial.folder / CLOSING).touch()
    client.request("stop", "stop z")
    in_z = client.written
    client.write(3)
    client.request("start", "start a", task="a")
    client.write(10)
    wait_until((trial.folder / HELD).exists)
    client.request("stop", "stop a")
    in_a = client.written
    client.write(3)
    client.request("start", "start b", task="b")
    client.write(10)
    wait_until(lambda: client.answered("start b"))
    recorder.end()
    recorder = trial.life(Orders())
    wait_until(lambda: trial.is_in("b", recorder))
    assert client.ask("stop").ok
    recorder.end(signal.SIGTERM)
    trial.assert_whole({"z": (1, in_z), "a": (in_z + 4, in_a), "b": (in_a + 4, client.written)})


@pytest.mark.parametrize(("kills", "is_removed"), [(0, True), (3, True), (5, False)])
def test_an_episode_that_never_began_is_no_matter_for_a_repair(trial: Trial, kills: int, is_removed: bool) -> None:
    data = trial.folder / "data"
    recorder = trial.life(Orders(kills=kills))
    wait_until(lambda: trial.client.state(recorder) is not None)
    trial.client.request("start", "start b", task="b")
    wait_until(recorder.is_dead)
    (folder,) = data.glob("b/*/")
    assert (folder / layout.MANIFEST).exists() is not is_removed
    (data / "b" / "notes").mkdir()
    with (data / ".recorder.lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert CliRunner().invoke(cli, ["episodes", "repair", "--all", "--data", str(data)]).exit_code == 0
        assert folder.exists(), "its recorder lives"
    done = CliRunner().invoke(cli, ["episodes", "repair", "--all", "--data", str(data)])
    assert done.exit_code == 0, done.output
    assert folder.exists() is not is_removed
    assert (data / "b" / "notes").exists()
