"""A minute against the clock, with strangers on the bus: everything is there, and everybody kept the rate."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import mkdtemp

import pytest

from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.main_job.by_the_clock import BODY, CHECKS, Run, recorded_run
from tests.main_job.writers import NATIVE_HZ

RUN_S = 60.0
SHARE = 0.9  # of the writes that are due in that time
STEP_HZ = 50.0


@pytest.mark.timeout(600)
def test_in_a_minute_nothing_is_lost_and_the_rates_are_kept(tmp_path: Path, processes: None, proof: Figures) -> None:
    in_time(lambda: record_a_minute(Path(mkdtemp(dir=tmp_path)), proof), rounds=2)


def record_a_minute(folder: Path, proof: Figures) -> None:
    began_s: list[float] = []

    def is_over(*_: object) -> bool:
        began_s.append(time.monotonic())
        return began_s[-1] - began_s[0] > RUN_S

    with Waits.watched() as waits, recorded_run(folder, is_over) as run:
        for check in CHECKS:
            check(run)
        steps = run.terminal.json("audit", str(run.reader.folder))["steps"]
    expect_rate(run.sensor_count, NATIVE_HZ, waits)
    expect_rate(last_of(run, BODY), STEP_HZ, waits)
    expect_rate(steps, STEP_HZ, waits)
    assert run.reader.manifest.recorder.messages > 0
    proof.figure("a minute of the main job: messages recorded", run.reader.manifest.recorder.messages)
    proof.figure("a minute of the main job: steps of the robot", steps, limit=f"{SHARE * STEP_HZ * RUN_S:.0f} or more")


def last_of(run: Run, key: str) -> int:
    return max(count for (name, _), count in run.last.items() if name == key)


def expect_rate(count: int, hz: float, waits: Waits) -> None:
    """Fail where fewer were written than were due; see `tests.lateness`."""
    if (missing := SHARE * hz * RUN_S - count) >= 0:
        raise TooLate(f"{count} of {hz * RUN_S:.0f}", missing / hz, waits.seconds())
