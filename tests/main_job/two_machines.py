"""A station on two or three machines with a bad line between them, and a check of what it recorded.

The robot is on one machine and its commander on another; the recorder is on either, or on a third.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1 import twist_keys
from station import Station, open_episode
from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.clocks import KEPT, decode_statement
from station.contract import TIMING_STAGES
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.life.server import Health
from tests.cli.running import Home, Running, new_home
from tests.network_link import machine
from tests.network_link.far_bus import PORT, FarBus, far_bus
from tests.network_link.link import End, Link

BOOT, STORE_BOOT = "0badcafe", "0badf00d"
"""Names of the boots of the operator's machine, and of that which records."""
AHEAD_S = {BOOT: 7200, STORE_BOOT: 86_400}
"""What their monotonic clocks are ahead of the robot's, by boot."""
OWN_ERROR_S = 0.001
"""Of the clock of the robot's machine, on which the bus runs."""
LIMIT_S = 0.25
"""An older command moves nothing."""
ASKED_WITHIN_S = 2.0
"""So long after a clock's statement every reader goes by it, or by a newer one: readers ask every second."""
WRITTEN, OBSERVED = TIMING_STAGES.index("command_written"), TIMING_STAGES.index("observed")


class Site(NamedTuple):
    """A bus and a robot on one machine, a motion on another, and a recorder on either or a third.

    Attributes:
        link: Between them.
        robot, operator, store: The machines; the last records.
        bus: As the robot's machine reaches it.
        runs: The motion, or the station that runs it.
    """

    link: Link
    robot: Home
    operator: Home
    store: Home
    bus: BusAddress
    runs: Running

    def server(self, name: str) -> Health | None:
        """What a server says of itself."""
        with Station(self.bus.url) as station:
            return next((health for health in station.servers() if health.name == name), None)

    def seen(self) -> dict[str, object]:
        """What the robot's server says of the robot."""
        health = self.server("g1")
        return {} if health is None else health.detail

    def knows_clock(self) -> bool:
        """Whether the operator's machine has compared its clock often enough."""
        with Bus(self.bus, name="test", timeout_s=5.0) as bus:
            said = decode_statement(bus.get(keys.clock(BOOT)), BOOT)
        return said is not None and said.comparisons >= KEPT

    def stale(self) -> int:
        """How many commands the robot's server has refused for their age."""
        refused = self.seen().get("refused")
        return int(refused.get("stale", 0)) if isinstance(refused, dict) else 0


@contextmanager
def two_machines(*, recorder_is_far: bool) -> Iterator[Site]:
    """Have them, with a line of 5 ± 10 ms that loses 1 %."""
    with far_bus(seed=5) as far, ExitStack() as stack:
        operator = stack.enter_context(new_home(_other_machine(far.there.end, BOOT)))
        operator.environment |= _reaches(far)

        def serve(home: Home, server: str, *sets: str) -> Running:
            words = [word for each in sets for word in ("--set", each)]
            running = stack.enter_context(home.running("serve", server, *words))
            running.wait_for(f"{server} is active")
            return running

        serve(far.home, "g1")
        serve(operator if recorder_is_far else far.home, "recorder")
        far.link.change(delay_s=0.005, jitter_s=0.01, loss=0.01)
        motion = serve(operator, "motion", "motion=builtin:wave", "loop=true")
        yield Site(far.link, far.home, operator, operator if recorder_is_far else far.home, far.here, motion)


@contextmanager
def three_machines(task: str) -> Iterator[Site]:
    """Have them, with such a line, and one runbook that the operator runs, which records a task of some name: robot and
    recorder have machines of their own."""
    with far_bus(seed=5, ends=3) as far, ExitStack() as stack:
        ends = zip(far.link.ends[1:], (BOOT, STORE_BOOT), strict=True)
        operator, store = (stack.enter_context(new_home(_other_machine(end, boot))) for end, boot in ends)
        for home in (operator, store):
            home.environment |= _reaches(far)
        for name, home in (("robot", far.home), ("store", store)):
            agent = stack.enter_context(home.running("host", "join", "--name", name))
            agent.wait_for(f"host-{name} is active")
        far.link.change(delay_s=0.005, jitter_s=0.01, loss=0.01)
        places = ("--on", "g1=robot", "--on", "recorder=store")
        sets = ("--set", "motion.motion=builtin:wave", "--set", "motion.loop=true")
        station = stack.enter_context(
            operator.running("up", "g1-sim-motion", *places, *sets, "--yes", "--record", "--task", task)
        )
        station.wait_for("✓ start motion")
        yield Site(far.link, far.home, operator, store, far.here, station)


def _other_machine(end: End, boot: str) -> tuple[str, ...]:
    return (*end.prefix, *machine.prefix(AHEAD_S[boot], boot))


def _reaches(far: FarBus) -> dict[str, str]:
    return {"STATION_BUS": f"redis://{far.there.host}:{PORT}/0", "STATION_BUS_PASSWORD_FILE": str(far.secret)}


class Judged(NamedTuple):
    """What was found in an episode.

    Attributes:
        off_s: By how much the operator's clock was taken wrongly at most [s].
        oldest_s: Age of the oldest command that was followed [s].
        lost: Commands that are in no recording.
        told_lost: Values that the motion server said it had lost.
    """

    off_s: float
    oldest_s: float
    lost: int
    told_lost: int


def judge(folder: Path) -> Judged:
    """Expect that the robot followed no command older than the limit, by clocks that know better than the station."""
    key = twist_keys.action_body()
    reader = EpisodeReader(signals_file(folder))
    marks = [stamp.decode(message.stamp or b"") for message in reader.messages([key], stamps=True)]
    truly_s = {mark.seq: mark.mono_ns * 1e-9 - AHEAD_S[BOOT] for mark in marks if mark is not None}
    steps = open_episode(folder).steps()
    has_timing = np.isfinite(steps.timing["tick"])  # not of a step that a cut, or the end, has parted
    ticks, numbers = (steps.timing[name][has_timing].astype(int) for name in ("tick", "command_seq"))
    gate = steps.gate[has_timing]
    by_tick = {int(row[0]): row[2:] * 1e-9 for row in _timing(reader)}  # by the robot's clock, wherever it was recorded
    instants = np.array([by_tick[tick] for tick in ticks])
    written_s, used_s = instants[:, WRITTEN], instants[:, OBSERVED]
    is_known = written_s > 0
    first = int(np.argmax(is_known))  # before it is the pre-roll, in which the clock was not known yet
    assert is_known[first:].all()
    truth_s = np.array([truly_s.get(number, np.nan) for number in numbers])
    said = [decode_statement(message.data, BOOT) for message in reader.messages([keys.clock(BOOT)])]
    assert len(said) >= 3, "every second, in the recording"
    assert said[0] is not None
    # Until then a clock may be read by an earlier statement, which is in no recording, nor is how wrong it may be.
    since_s = said[0].mono_ns * 1e-9 - AHEAD_S[BOOT] + ASKED_WITHIN_S
    judged = is_known & np.isfinite(truth_s) & (used_s >= since_s)  # what was written before the pre-roll is in none
    bound_s = max(statement.error_ns for statement in said if statement is not None) * 1e-9 + OWN_ERROR_S
    off_s = np.abs(written_s - truth_s)[judged]
    assert off_s.max() <= bound_s, "as the robot's machine took it"
    for statement in said:
        assert statement is not None
        wrong_s = (statement.to_bus - (statement.wall_ns - statement.mono_ns)) * 1e-9  # both have one wall clock
        assert abs(wrong_s) <= statement.error_ns * 1e-9 + OWN_ERROR_S
    follows = judged & np.isin(gate, ["entering", "tracking"])
    assert follows.sum() > 50
    oldest_s = (used_s - truth_s)[follows].max()
    assert oldest_s <= LIMIT_S + bound_s
    _expect_written_before_arrived(reader, bound_s, since_s)
    events = [event.value for event in open_episode(folder).events() if isinstance(event.value, dict)]
    told = sum(event["detail"].get("lost_writes", 0) for event in events if event["source"].startswith("motion"))
    lost = max(truly_s) - min(truly_s) + 1 - len(truly_s)
    return Judged(float(off_s.max()), float(oldest_s), lost, told)


def _expect_written_before_arrived(reader: EpisodeReader, bound_s: float, since_s: float) -> None:
    """Expect that what the file says of when another machine wrote is on the episode's clock, to within a bound [s].

    Only of what was written since an instant of the robot's clock [s].
    """
    assert reader.anchor is not None
    anchor_ns = reader.anchor.mono_ns - _ahead_ns(reader.anchor.boot)  # on the robot's clock
    judged = 0
    for message in reader.messages(stamps=True):
        mark = stamp.decode(message.stamp or b"")
        if mark is None or stamp.boot_of(mark.source) == reader.anchor.boot or message.publish_ns == message.log_ns:
            continue
        mono_ns = mark.mono_ns - _ahead_ns(stamp.boot_of(mark.source))
        if mono_ns < since_s * 1e9:
            continue
        off_s = (message.publish_ns - reader.anchor.wall_ns - (mono_ns - anchor_ns)) * 1e-9
        assert abs(off_s) <= bound_s + OWN_ERROR_S
        judged += 1
    assert judged > 100


def _ahead_ns(boot: str) -> int:
    return AHEAD_S.get(boot, 0) * 1_000_000_000


def _timing(reader: EpisodeReader) -> Iterator[NDArray[np.float64]]:
    """The rows of `policy_timing`: tick, number of the command, and the instants of the step [ns]."""
    for message in reader.messages([keys.policy_timing(twist_keys.TWIST2_ROBOT)]):
        yield codec.parse_json_vector(message.data)
