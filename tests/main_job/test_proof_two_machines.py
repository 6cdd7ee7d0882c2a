"""A robot on one machine, its operator and a recorder on another, over a bad line that is cut at random for minutes."""

from __future__ import annotations

import random
import time

import pytest

from station import Station
from tests.figures import Figures
from tests.main_job.two_machines import judge, two_machines
from tests.waiting import wait_until

MINUTES = 10
LONGEST_CUT_S = 5.0
CLOCK_ERROR_S = 0.005
"""As much as a clock may be taken wrongly over a line of 5 ± 10 ms with 1 % of loss."""

pytestmark = pytest.mark.timeout(60 * MINUTES + 300)


def test_nothing_old_is_followed_nobody_falls_and_nothing_is_lost_untold(proof: Figures, network_links: None) -> None:
    chance, cuts = random.Random(18), 0
    with two_machines(recorder_is_far=True) as site:
        wait_until(site.knows_clock)
        with Station(site.bus.url) as station:
            station.record.start("far")
            until_s = time.monotonic() + 60 * MINUTES
            while time.monotonic() < until_s:
                time.sleep(chance.uniform(3.0, 15.0))
                site.link.pull()
                time.sleep(chance.uniform(0.1, LONGEST_CUT_S))
                site.link.plug()
                cuts += 1
            wait_until(lambda: site.seen().get("gate") == "tracking")
            answer = station.record.stop()
            stale = site.stale()
            falls = site.seen().get("falls", 0)
        found = judge(site.operator.episode("far"))
        audit = site.operator.run("audit", "latest")
    proof.figure("cuts of up to 5 s", cuts)
    proof.figure("commands refused for their age", stale)
    proof.figure("oldest command that was followed", found.oldest_s * 1e3, "ms", "≤ 250 and the clock's error")
    proof.figure("operator's clock taken wrongly, at most", found.off_s * 1e3, "ms", "≤ 5")
    proof.figure("commands lost, all told", found.lost)
    assert (falls, answer.summary["falls"], answer.summary["holes"]) == (0, 0, 0)
    assert stale > 0
    assert found.off_s <= CLOCK_ERROR_S
    assert found.told_lost >= found.lost, "each is in an event"
    assert audit.returncode == 0, audit.stdout
