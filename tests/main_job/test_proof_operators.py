"""A fake operator of each device is followed for most of the time in which it drives, and the episode is sound."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

import pytest

from tests.cli.running import Home
from tests.figures import Figures
from tests.late_verdicts import expect_no_worse_in_time
from tests.lateness import STALE_S, TooLate, Waits, in_time
from tests.main_job.device_runs import SCRIPTS, drive, steps, tracked
from tests.servers.g1_station import Log

TRACKED = 100  # steps: two seconds
LONGEST = 2500  # steps: fifty seconds
SHARE = 0.3  # of all steps, those in which the operator was followed

pytestmark = pytest.mark.timeout(480)


def is_followed(log: Log) -> bool:
    return tracked(log) >= max(TRACKED, 1.2 * SHARE * steps(log))


@pytest.mark.parametrize("device", SCRIPTS)
def test_the_robot_follows_for_most_of_the_time(device: str, tmp_path: Path, processes: None, proof: Figures) -> None:
    def once() -> None:
        lost: list[str] = []

        def is_over(log: Log) -> bool:
            if steps(log) > LONGEST and not is_followed(log):
                told = log.events("operator-disengaged", "operator-refused")
                lost.append(f"{tracked(log)} of {steps(log)} steps: {[event.detail['reason'] for event in told]}")
            return bool(lost) or is_followed(log)

        with Waits.watched() as waits:
            check = drive(device, Home(Path(mkdtemp(dir=tmp_path))), is_over)
        if lost:  # samples came late, and until the next press nobody drives
            raise TooLate(lost[0], STALE_S / 2, waits.longest_s)
        (robot,) = check.steps
        assert robot.gate_shares["tracking"] > SHARE
        expect_no_worse_in_time("usable", check, waits)
        proof.figure(f"{device}: age of the command at a step, p99", (robot.command_age.p99_s or 0.0) * 1e3, "ms")

    in_time(once, rounds=3)
