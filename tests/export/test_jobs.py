"""One function for every episode, in processes or on Ray: a bad one ends nothing."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from station.errors import BadFile, StationError, UsageError
from station.export.jobs import Attempt, DiskRefuses, map_episodes
from tests.cli.running import are_gone
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")

ROOT = Path(__file__).parents[2]


def square(number: int) -> int:
    """Fails in every way there is, by number."""
    if number == 3:
        raise BadFile("3: no such\n  thing")
    if number == 5:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "five.mcap")
    if number == 7:
        return {}["seven"]  # type: ignore[no-any-return]
    return number * number


def die(number: int) -> int:
    """Some episodes take their process with them."""
    if number % 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def fill_the_disk(number: int) -> int:
    if number == 2:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "shard.parquet")
    return number


def by_item(attempts: list[Attempt[int, int]]) -> dict[int, int | str]:
    return {each.item: each.error or each.result or 0 for each in attempts}


def check_squares(found: dict[int, int | str]) -> None:
    assert list(found) == list(range(1, 9)), "in the order of the items"
    assert [found[n] for n in (1, 2, 4, 6, 8)] == [1, 4, 16, 36, 64]
    assert found[3] == "3: no such thing"
    assert found[5] == "five.mcap: No such file or directory"
    assert str(found[7]).startswith("internal error: tests.export.test_jobs line ")
    assert str(found[7]).endswith(": KeyError: 'seven'")


@pytest.mark.parametrize("jobs", [1, 3])
def test_an_item_that_fails_leaves_the_others_as_they_are_and_says_why_in_a_line(jobs: int) -> None:
    told: list[int] = []
    attempts = map_episodes(square, range(1, 9), jobs=jobs, on_done=lambda each: told.append(each.item))
    check_squares(by_item(attempts))
    assert sorted(told) == list(range(1, 9))


def test_a_process_that_dies_costs_its_item_and_another_takes_its_place() -> None:
    found = by_item(map_episodes(die, range(1, 8), jobs=2))
    assert {n: found[n] for n in (2, 4, 6)} == {2: 2, 4: 4, 6: 6}
    assert all("SIGKILL (is there enough memory?" in str(found[n]) for n in (1, 3, 5, 7))


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_full_disk_ends_the_work_since_no_other_would_fare_better(jobs: int) -> None:
    with pytest.raises(DiskRefuses, match=r"^shard\.parquet: No space left on device$"):
        map_episodes(fill_the_disk, range(1000), jobs=jobs)


needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="the extra 'ray' is not installed")


@needs_ray
@pytest.mark.parametrize(
    ("address", "kind", "told"),
    [
        ("127.0.0.1:1", StationError, "--ray 127.0.0.1:1: nothing answers there (Connection refused)"),
        ("somewhere", UsageError, "--ray 'somewhere': expected host:port, ray://host:port, auto or local"),
    ],
)
def test_a_cluster_that_is_not_there_is_told_at_once(address: str, kind: type[StationError], told: str) -> None:
    with pytest.raises(kind) as caught:
        map_episodes(square, [1], ray_address=address)
    assert str(caught.value).startswith(told)


def test_without_ray_the_error_names_the_extra() -> None:
    code = (
        "import sys; sys.modules['ray'] = None\n"
        "from station.export.jobs import map_episodes\n"
        "from tests.export.test_jobs import square\n"
        "try: map_episodes(square, [1], ray_address='local')\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "StationError --ray needs ray; install the extra: pip install 'teleop-station[ray]'\n"


def test_an_interrupt_ends_everybody(tmp_path: Path) -> None:
    code = "from tests.export.test_jobs import until_interrupted; until_interrupted()"
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as parent:  # fmt: skip
        assert parent.stdout is not None
        children = [int(parent.stdout.readline()) for _ in range(2)]
        os.killpg(parent.pid, signal.SIGINT)
        _, said = parent.communicate(timeout=DEADLINE_S)
    assert said.rstrip().endswith("KeyboardInterrupt")
    wait_until(lambda: are_gone(children))


def until_interrupted() -> None:
    """Say who works, then work for ever."""
    map_episodes(wait_for_ever, [0, 0, 1, 1], jobs=2, on_done=lambda each: print(each.result, flush=True))  # noqa: T201


def wait_for_ever(number: int) -> int:
    if number:
        signal.pause()
    return os.getpid()
