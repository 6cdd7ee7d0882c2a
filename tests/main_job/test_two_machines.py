"""After a cut no old command of another machine moves a joint, and what was recorded there has lost nothing untold."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator

import pytest

from station import Station
from tests.main_job.two_machines import Site, judge, two_machines
from tests.waiting import wait_until

CUT_S, MOST_CUTS = 2.0, 5

pytestmark = pytest.mark.timeout(240)


@pytest.fixture(params=[False, True], ids=["recorder beside the robot", "recorder beside the operator"])
def site(request: pytest.FixtureRequest, network_links: None) -> Iterator[Site]:
    with two_machines(recorder_is_far=request.param) as found:
        yield found


def test_after_a_cut_no_old_command_of_another_machine_is_followed(site: Site) -> None:
    with Station(site.bus.url) as station:
        site.motion.wait_until(lambda: site.seen().get("command_age_by") == "stamp and arrival")
        wait_until(site.knows_clock)
        station.record.start("cut")
        wait_until(lambda: site.seen()["gate"] == "tracking")
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
    home = site.operator if (site.operator.data / "cut").exists() else site.robot
    judge(home.episode("cut"))
    assert re.search(r"clock of \S+: known to \d+\.\d ms", site.robot.run("doctor").stdout)
