"""A robot on one machine and who commands it on another, over a bad line that is cut: no old command moves a joint."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station import Station, open_episode
from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.clocks import decode_statement
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from tests.cli.running import Home, Running, new_home
from tests.network_link import machine
from tests.network_link.far_bus import PORT, far_bus
from tests.network_link.link import Link
from tests.waiting import wait_until

AHEAD_S, BOOT = 7200, "0badcafe"
CLOCK_ERROR_S = 0.005
"""As much as a clock may be wrong over a line of 5 ± 10 ms with 1 % of loss."""
LIMIT_S = 0.25
CUT_S = 2.0
MOST_CUTS = 5

pytestmark = pytest.mark.timeout(240)


class Site(NamedTuple):
    """A bus, a robot and a recorder on one machine, a motion on the other."""

    link: Link
    robot: Home
    operator: Home
    bus: BusAddress
    motion: Running

    def seen(self) -> dict[str, object]:
        """What the robot's server says of itself."""
        with Station(self.bus.url) as station:
            return next((health.detail for health in station.servers() if health.name == "g1"), {})

    def counted(self, kind: str) -> int:
        refused = self.seen().get("refused")
        return int(refused.get(kind, 0)) if isinstance(refused, dict) else 0


@pytest.fixture
def site(network_links: None) -> Iterator[Site]:
    with far_bus(seed=5) as far, ExitStack() as stack:
        operator = stack.enter_context(new_home((*far.there.end.prefix, *machine.prefix(AHEAD_S, BOOT))))
        operator.environment |= {
            "STATION_BUS": f"redis://{far.there.host}:{PORT}/0", "STATION_BUS_PASSWORD_FILE": str(far.secret),
        }  # fmt: skip
        for server in ("g1", "recorder"):
            running = stack.enter_context(far.home.running("serve", server))
            running.wait_for(f"{server} is active")
        far.link.change(delay_s=0.005, jitter_s=0.01, loss=0.01)
        sets = ("--set", "motion=builtin:wave", "--set", "loop=true")
        motion = stack.enter_context(operator.running("serve", "motion", *sets))
        yield Site(far.link, far.home, operator, far.here, motion)


def test_after_a_cut_no_old_command_of_another_machine_is_followed(site: Site) -> None:
    with Station(site.bus.url) as station:
        site.motion.wait_until(lambda: site.seen().get("command_age_by") == "stamp and arrival")
        station.record.start("cut")
        wait_until(lambda: site.seen()["gate"] == "tracking")
        for _ in range(MOST_CUTS):  # of a hundred old commands in 50 ms the robot looks at two or three
            site.link.pull()
            time.sleep(CUT_S)
            site.link.plug()
            site.motion.wait_until(lambda: site.seen()["gate"] == "tracking")
            if site.counted("stale"):
                break
        assert site.counted("stale")
        station.record.stop()
    _judge(site.robot.episode("cut"))
    assert re.search(r"clock of \S+: known to \d+\.\d ms", site.robot.run("doctor").stdout)


def _judge(folder: Path) -> None:
    key = twist_keys.action_body()
    reader = EpisodeReader(signals_file(folder))
    marks = [stamp.decode(message.stamp or b"") for message in reader.messages([key], stamps=True)]
    truly_s = {mark.seq: mark.mono_ns * 1e-9 - AHEAD_S for mark in marks if mark is not None}
    steps = open_episode(folder).steps()
    assert reader.anchor is not None
    timing, begun_s = steps.timing, reader.anchor.mono_ns * 1e-9
    written_s, used_s = timing["command_written"] + begun_s, timing["observed"] + begun_s
    is_known = np.isfinite(written_s)
    first = int(np.argmax(is_known))  # before it is the pre-roll, in which the clock was not known yet
    assert is_known[first:].all()
    truth_s = np.array([truly_s.get(number, np.nan) for number in timing["command_seq"].astype(int)])
    judged = is_known & np.isfinite(truth_s)  # of the first commands the writes came before the pre-roll
    assert np.abs(written_s - truth_s)[judged].max() <= CLOCK_ERROR_S, "as the robot's machine took it"
    follows = judged & np.isin(steps.gate, ["entering", "tracking"])
    assert follows.sum() > 50
    assert (used_s - truth_s)[follows].max() <= LIMIT_S + CLOCK_ERROR_S
    said = [decode_statement(message.data, BOOT) for message in reader.messages([keys.clock(BOOT)])]
    assert len(said) >= 3, "every second, in the recording"
    for statement in said:
        assert statement is not None
        off_s = (statement.to_bus - (statement.wall_ns - statement.mono_ns)) * 1e-9  # one wall clock for both machines
        assert abs(off_s) <= statement.error_ns * 1e-9 + 1e-3
