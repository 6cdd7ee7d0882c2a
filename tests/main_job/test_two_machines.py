"""After a cut no old command of another machine moves a joint, and what was recorded there has lost nothing untold."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator

import pytest

from station import Station
from tests.main_job.two_machines import Site, judge, three_machines, two_machines
from tests.waiting import wait_until

CUT_S, MOST_CUTS = 2.0, 5

pytestmark = pytest.mark.timeout(240)


@pytest.fixture(params=[False, True], ids=["recorder beside the robot", "recorder beside the operator"])
def site(request: pytest.FixtureRequest, network_links: None) -> Iterator[Site]:
    with two_machines(recorder_is_far=request.param) as found:
        yield found


def test_one_runbook_runs_a_robot_its_operator_and_a_recorder_on_three_machines(network_links: None) -> None:
    with three_machines("three") as site:
        wait_until(site.knows_clock)
        wait_until(lambda: site.seen()["gate"] == "tracking")
        site.link.pull()
        time.sleep(CUT_S)
        site.link.plug()
        wait_until(lambda: site.seen()["gate"] == "tracking")
        time.sleep(2.0)  # of a walk to judge
        assert "record-start" in site.operator.run("logs", "recorder").stdout
        doctor = site.operator.run("doctor").stdout
        site.runs.interrupt()
        code, out = site.runs.finish()
        assert code == 0, site.runs.text
        folder = site.store.episode("three")
        assert out.strip() == f"store:{folder}"
        found = judge(folder)
        assert found.told_lost >= found.lost
        assert site.store.run("audit", "latest").returncode == 0
    assert "host robot: version" in doctor
    assert "host store: version" in doctor
    assert len(re.findall(r"clock of \S+: known to \d+\.\d ms", doctor)) == 3


def test_after_a_cut_no_old_command_of_another_machine_is_followed(site: Site) -> None:
    with Station(site.bus.url) as station:
        site.runs.wait_until(lambda: site.seen().get("command_age_by") == "stamp and arrival")
        wait_until(site.knows_clock)
        station.record.start("cut")
        wait_until(lambda: site.seen()["gate"] == "tracking")
        time.sleep(2.0)  # of a walk to judge
        for _ in range(MOST_CUTS):  # of a hundred old commands in 50 ms the robot looks at two or three
            site.link.pull()
            time.sleep(CUT_S)
            site.link.plug()
            wait_until(lambda: site.seen()["gate"] == "tracking")
            if site.stale():
                break
        assert site.stale()
        answer = station.record.stop()
    assert answer.summary["holes"] == 0
    judge(site.store.episode("cut"))
    assert re.search(r"clock of \S+: known to \d+\.\d ms", site.robot.run("doctor").stdout)
