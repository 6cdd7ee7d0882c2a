"""A run against the clock, with strangers on the bus: the recorder holds everything that anybody wrote."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from tests.main_job.by_the_clock import CHECKS, Run, recorded_run

WRITES = 600
"""Of the native writer beside the station: three seconds, where it is not kept waiting."""

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def run(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder = tmp_path_factory.mktemp("clock")
    with recorded_run(folder, lambda foreign, sensor: sensor.count > WRITES and len(foreign.written) > WRITES) as made:
        yield made


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__.removeprefix("check_"))
def test_run(check: Callable[[Run], None], run: Run) -> None:
    check(run)
