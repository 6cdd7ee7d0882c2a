"""One runbook, and a robot, its operator and a recorder on three machines, over a bad line that is cut at random for an
hour."""

from __future__ import annotations

import random
import time

import pytest

from station import open_episode
from tests.figures import Figures
from tests.main_job.two_machines import judge, three_machines
from tests.waiting import wait_until

MINUTES = 60
LONGEST_CUT_S = 5.0
CLOCK_ERROR_S = 0.005
"""As much as a clock may be taken wrongly over a line of 5 ± 10 ms with 1 % of loss."""

pytestmark = pytest.mark.timeout(60 * MINUTES + 300)


def test_nothing_old_is_followed_nobody_falls_and_nothing_is_lost_untold(proof: Figures, network_links: None) -> None:
    chance, cuts = random.Random(18), 0
    with three_machines("far") as site:
        wait_until(site.knows_clock)
        until_s = time.monotonic() + 60 * MINUTES
        while time.monotonic() < until_s:
            time.sleep(chance.uniform(3.0, 15.0))
            site.link.pull()
            time.sleep(chance.uniform(0.1, LONGEST_CUT_S))
            site.link.plug()
            cuts += 1
        wait_until(lambda: site.seen().get("gate") == "tracking")
        stale = site.stale()
        falls = site.seen().get("falls", 0)
        site.runs.interrupt()
        code, _ = site.runs.finish()
        assert code == 0, site.runs.text
        folder = site.store.episode("far")
        manifest = open_episode(folder).manifest
        found = judge(folder)
        audit = site.store.run("audit", "latest")
    proof.figure("cuts of up to 5 s", cuts)
    proof.figure("commands refused for their age", stale)
    proof.figure("oldest command that was followed", found.oldest_s * 1e3, "ms", "≤ 250 and the clock's error")
    proof.figure("operator's clock taken wrongly, at most", found.off_s * 1e3, "ms", "≤ 5")
    proof.figure("commands lost, all told", found.lost)
    assert (falls, manifest.holes) == (0, [])
    assert stale > 0
    assert found.off_s <= CLOCK_ERROR_S
    assert found.told_lost >= found.lost, "each is in an event"
    assert audit.returncode == 0, audit.stdout
