"""Work in several processes: order, errors, and that nobody outlives whom he works for."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from station import side_by_side
from station.errors import BadFile, StationError, UsageError
from tests.cli.running import are_gone
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")

ROOT = Path(__file__).parents[1]


def double(number: int) -> int:
    return 2 * number


def process_of(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def process_of_turn(task: tuple[Path, int]) -> int:
    """The first turn ends when all others have."""
    folder, turn = task
    if turn == 0:
        wait_until(lambda: len(list(folder.iterdir())) == 3)
    else:
        (folder / str(turn)).touch()
    return os.getpid()


def refuse(number: int) -> int:
    if number == 1:
        raise BadFile(f"{number}.pkl: no such file")
    raise StationError("something in the world")


def die(number: int) -> int:
    os._exit(7)


@pytest.mark.parametrize("jobs", [1, 3])
def test_results_come_in_the_order_of_the_tasks_and_are_told_as_they_come(jobs: int) -> None:
    told: list[int] = []
    assert side_by_side.run(double, [3, 1, 2], jobs=jobs, on_done=told.append) == [6, 2, 4]
    assert sorted(told) == [2, 4, 6]


def test_no_task_is_no_work() -> None:
    assert side_by_side.run(double, [], jobs=2) == []


def test_a_process_does_many_tasks_while_another_is_busy_with_a_long_one(tmp_path: Path) -> None:
    long, *short = side_by_side.run(process_of_turn, [(tmp_path, turn) for turn in range(4)], jobs=2)
    assert len(set(short)) == 1
    assert len({long, short[0], os.getpid()}) == 3


@pytest.mark.parametrize(("number", "kind"), [(1, UsageError), (2, StationError)])
@pytest.mark.parametrize("jobs", [1, 2])
def test_the_first_problem_ends_the_rest_in_one_line_of_its_kind(number: int, kind: type, jobs: int) -> None:
    with pytest.raises(kind) as caught:
        side_by_side.run(refuse, [number] * 4, jobs=jobs)
    assert isinstance(caught.value, UsageError) == (kind is UsageError)
    assert "\n" not in str(caught.value)


def test_a_process_that_dies_is_told() -> None:
    with pytest.raises(StationError, match="ended with exit code 7"):
        side_by_side.run(die, [0, 1], jobs=2)


def hold_a_lock(number: int) -> int:
    """Keep what the system must get back, as libraries do."""
    global LOCK  # noqa: PLW0603
    LOCK = multiprocessing.get_context("spawn").Lock()
    return number


LOCK = None


def test_a_child_gives_back_what_its_libraries_took_of_the_system() -> None:
    code = "from station import side_by_side; from tests.test_side_by_side import hold_a_lock; "
    code += "side_by_side.run(hold_a_lock, [0, 1], jobs=2)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr == "", "Python tells of semaphores that nobody gave back"


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_children_end_with_their_parent_however_it_ends(sent: signal.Signals) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", "from tests.test_side_by_side import parent; parent()"],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert parent.stdout is not None
    children = [int(parent.stdout.readline()) for _ in range(2)]
    os.killpg(parent.pid, sent) if sent == signal.SIGINT else parent.send_signal(sent)
    _, said = parent.communicate(timeout=DEADLINE_S)
    wait_until(lambda: are_gone(children), DEADLINE_S)
    assert "SpawnProcess" not in said, "an interrupt of the whole group is no child's business"


def parent() -> None:
    """Work until somebody ends it; say who the children are."""
    side_by_side.run(process_of, [0.0, 0.0] + [60.0] * 4, jobs=2, on_done=lambda pid: print(pid, flush=True))  # noqa: T201
