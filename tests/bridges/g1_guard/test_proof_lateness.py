"""Ten minutes of a whole station over the guard: how late its loop is, how old what it uses, and what it sends (R9)."""

from __future__ import annotations

import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

import station
from adapters.robots.g1.dds import messages, topics, types
from adapters.robots.g1.dds.network import Network, RawMessage
from adapters.robots.g1.dds.options import NetworkOptions
from station import Episode
from tests.bridges.g1_guard.bench import guarded
from tests.cli.running import Home, new_home
from tests.figures import Figures

SECONDS = 600.0  # in which it follows the motion
SETTLED_S = 5.0  # until its ticks have moved to just behind the commands
NEIGHBOURS = 10
PERIOD_S = 0.02
TICK_MS = 2

Instants = NDArray[np.float64]


class Line:
    """Hears what passes on a robot's network, and when it was sent, as its senders say [s, monotonic]."""

    def __init__(self, network: Network) -> None:
        self._states = network.reader(topics.LOW_STATE, types.LowState, depth=4096)
        self._commands = network.reader(topics.LOW_CMD, types.LowCmd, depth=4096)
        self._asked = b""
        self.states: dict[int, float] = {}
        self.commands: list[float] = []

    def listen(self) -> None:
        """Take what came; of the states their ticks, of the commands those that ask for something new."""
        is_ahead_s = (time.time_ns() - time.monotonic_ns()) * 1e-9
        for message in self._states.take_stamped():
            (tick,) = struct.unpack_from("<I", message.data, messages.STATE.fields["tick"][1])
            self.states[tick] = _sent_s(message) - is_ahead_s
        for message in self._commands.take_stamped():
            record = messages.command(message.data)
            assert record is not None
            if (asked := record["motors"]["q"].tobytes()) != self._asked:
                self._asked = asked
                self.commands.append(_sent_s(message) - is_ahead_s)


def _sent_s(message: RawMessage) -> float:
    return float(message.sample_info.source_timestamp) * 1e-9


def _lateness_s(ticks: Instants, read_s: Instants) -> Instants:
    """Return how late each state was read, beside the most punctual of its neighbours; ticks move, by 0.2 ms each."""
    phase = read_s - PERIOD_S * ticks
    windows = np.lib.stride_tricks.sliding_window_view(phase, 2 * NEIGHBOURS + 1)
    return np.asarray(phase[NEIGHBOURS:-NEIGHBOURS] - windows.min(axis=1))


def _ages_of_states_s(episode: Episode, read_s: Instants, used_s: Instants, line: Line) -> Instants:
    """Return how long before its use the state of each step was sent; a step's is the newest of those it recorded."""
    samples = episode.numpy("state_samples", "tick")
    last = np.append(np.flatnonzero(np.diff(samples.written_s) > 0.0), len(samples) - 1)
    newest = last[np.searchsorted(samples.written_s[last], read_s)]
    # What this process lost, which is late sooner than a robot's server, was sent between its neighbours.
    sent_s = np.interp(samples["tick"][newest], list(line.states), list(line.states.values()))
    return used_s - (sent_s - episode.mono_ns(0.0) * 1e-9)


def _network(number: int) -> Network:
    """Join a network; threads that take what comes have real-time priority, as those of a robot have."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    try:
        return Network(NetworkOptions(domain=number))
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _record(home: Home, guard: Path) -> tuple[Episode, Line]:
    with guarded(guard) as (number, settings), _network(number) as network:
        line = Line(network)
        options = (*settings, "motion.motion=builtin:sway", "motion.loop=true")
        words = [word for option in options for word in ("--set", option)]
        for_s = f"{SECONDS + SETTLED_S:g}s"
        with home.running("up", "g1-twin-motion", "--yes", "--record", "--task", "sway", "--for", for_s, *words) as up:
            while up.process.poll() is None:
                time.sleep(0.25)
                line.listen()
            assert up.finish()[0] == 0, up.text
    return station.open_episode(home.episode("sway")), line


@pytest.mark.timeout(SECONDS + 600)
def test_r9_the_loop_is_punctual_and_what_it_uses_is_fresh(
    processes: None, real_time: None, compiler: str, plain: Path, proof: Figures
) -> None:
    with new_home() as home:
        episode, line = _record(home, plain)
        steps, zero_s = episode.steps(), episode.mono_ns(0.0) * 1e-9
        commands_s = np.array(line.commands) - zero_s
        has_reached = steps.timing["sent"] < commands_s[-1]  # the motors: what is sent to a guard in damping does not
        chosen = np.flatnonzero((steps.gate == "tracking") & has_reached)[round(SETTLED_S / PERIOD_S) :]
        timing = {name: steps.timing[name][chosen] for name in ("tick", "state_read", "observed", "sent")}
        late_s = _lateness_s(timing["tick"], timing["state_read"])
        of_states_s = _ages_of_states_s(episode, timing["state_read"], timing["observed"], line)
        of_commands_s = commands_s[np.searchsorted(commands_s, timing["sent"])] - timing["sent"]
        samples = episode.numpy("state_samples", "tick")
        faults = [record.value for record in episode.events() if "robot-fault" in record.value.values()]
    ticks = samples["tick"].astype(int)
    span_s = samples.written_s[-1] - samples.written_s[0]
    kept_hz, missing = (
        (len(ticks) - np.sum(samples.written_s == samples.written_s[0])) / span_s,
        (ticks[-1] - ticks[0]) // TICK_MS + 1 - len(np.unique(ticks)),
    )
    minutes = f"in {len(chosen) * PERIOD_S / 60.0:.0f} minutes"
    proof.figure(f"loop of a G1's server, lateness {minutes}: p99", p99_ms(late_s), "ms", limit="2 ms")
    proof.figure(f"loop of a G1's server, lateness {minutes}: worst", float(late_s.max()) * 1e3, "ms", limit="10 ms")
    proof.figure(
        f"age of a G1's state when its policy has seen it {minutes}: p99", p99_ms(of_states_s), "ms", limit="5 ms"
    )
    proof.figure(
        f"age of a G1's targets when its guard sends them {minutes}: p99", p99_ms(of_commands_s), "ms", limit="2 ms"
    )
    proof.figure(f"states of a G1 in a recording {minutes}", kept_hz, "Hz", limit="500 ± 1 Hz")
    assert faults == []
    assert len(chosen) > 0.9 * SECONDS / PERIOD_S
    assert missing == 0
    assert len(ticks) == len(np.unique(ticks))
    assert abs(kept_hz - 500.0) <= 1.0
    assert p99_ms(late_s) < 2.0
    assert late_s.max() < 0.01
    assert p99_ms(of_states_s) < 5.0
    assert p99_ms(of_commands_s) < 2.0


def p99_ms(seconds: Instants) -> float:
    return float(np.percentile(seconds, 99)) * 1e3
