"""What Python hands to the loop and back is never torn, lost or waited for: K13 of the table."""

from __future__ import annotations

import dataclasses
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from station_kord import PROFILES, KordBridge, SimOptions, State

from tests.bridges.kord.arms import LIMITS, ONE_JOINT, arm

PATTERN = np.arange(7) * 0.1
"""What joints differ by in every target: a mixture of two targets does not."""


@pytest.fixture(autouse=True)
def _threads_that_take_turns_often() -> Iterator[None]:
    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(usual_s)


def test_k13_targets_written_by_another_thread_are_never_mixed() -> None:
    profile = dataclasses.replace(PROFILES["time250"], offset_guard=False)  # its steps are no targets
    with arm(profile, buffer_len=100_000) as bridge:
        origin = bridge.get_state().q
        stop = threading.Event()

        def write() -> None:
            rng = np.random.default_rng(1)
            while not stop.is_set():
                bridge.stream_j(origin + rng.uniform(0, 0.001) + 0.001 * PATTERN)

        writer = threading.Thread(target=write)
        writer.start()
        try:
            while len(np.unique(bridge.trace()["q_sent"][:, 0])) < 500:
                bridge.step(200)
        finally:
            stop.set()
            writer.join()
        rows = bridge.trace()
        targets = rows["q_sent"][rows["sent"] == 1]
        assert np.allclose(targets - targets[:, :1], 0.001 * PATTERN, atol=1e-12)
        assert bridge.get_state().events == ()


def test_k13_states_read_by_other_threads_are_of_one_tick() -> None:
    with arm() as bridge:
        torn: list[State] = []
        read = [0, 0]
        stop = threading.Event()

        def look(who: int) -> None:
            while not stop.is_set():
                state = bridge.get_state()
                read[who] += 1
                if abs(state.mono_ns - state.tick * 4_000_000) > 0 and state.tick > 0:
                    torn.append(state)

        readers = [threading.Thread(target=look, args=(who,)) for who in range(2)]
        for reader in readers:
            reader.start()
        try:
            while min(read) < 500:
                bridge.step(50)
        finally:
            stop.set()
            for reader in readers:
                reader.join()
        assert torn == []


def test_of_many_targets_between_two_ticks_the_newest_is_sent_and_the_others_are_counted() -> None:
    with arm() as bridge:
        for number in range(1, 11):
            bridge.stream_j(0.0001 * number * ONE_JOINT)
        state = bridge.step(1)
        assert state.q_sent[0] == 0.001
        assert state.commands_dropped_by_throttle == 9


def test_a_target_that_stays_or_is_given_up_is_replaced_by_none() -> None:
    with arm() as bridge:
        for _ in range(100):
            bridge.stream_j(0.001 * ONE_JOINT)
            bridge.step(1)
        bridge.stream_j(0.002 * ONE_JOINT)
        assert bridge.step(1).commands_dropped_by_throttle == 0, "it was sent"
        bridge.stream_j(0.003 * ONE_JOINT)  # waits for its turn
        bridge.step(1)
        bridge.hold()
        bridge.step(10)
        bridge.stream_j(0.004 * ONE_JOINT)
        assert bridge.step(1).commands_dropped_by_throttle == 0, "nobody took the place of the third"
        bridge.stream_j(0.005 * ONE_JOINT)
        bridge.disengage()
        bridge.step(30)
        bridge.engage()
        bridge.stream_j(0.006 * ONE_JOINT)
        assert bridge.step(1).commands_dropped_by_throttle == 0, "the fifth was of an engagement that has ended"
        bridge.stream_j(0.007 * ONE_JOINT)  # waits
        bridge.step(1)
        bridge.stream_j(0.008 * ONE_JOINT)
        assert bridge.step(1).commands_dropped_by_throttle == 1


def test_a_target_written_while_another_one_waits_for_its_turn_takes_its_place() -> None:
    with arm() as bridge:
        bridge.stream_j(0.001 * ONE_JOINT)
        bridge.step(1)
        bridge.stream_j(0.002 * ONE_JOINT)
        assert bridge.step(1).q_sent[0] == 0.001
        bridge.stream_j(0.003 * ONE_JOINT)
        assert bridge.step(1).q_sent[0] == 0.003


def test_commands_and_states_wait_for_no_loop_that_stands_still() -> None:
    with arm() as bridge:  # a virtual clock that nobody steps is a loop that never comes round
        for number in range(1000):
            bridge.stream_j(1e-6 * number * ONE_JOINT)
            bridge.get_state()
        bridge.hold()
        bridge.set_throttle(3)
        assert bridge.get_state().tick == 0
        assert bridge.step(1).stream_j_sends == 0, "hold was the newest wish"


def test_the_trace_of_a_running_arm_can_be_read_again_and_again() -> None:
    with KordBridge(limits=LIMITS, sim=SimOptions(), trace_ticks=500) as bridge:
        bridge.connect()
        while bridge.get_state().tick < 20:
            rows = bridge.trace()
            assert np.all(np.diff(rows["tick"]) >= 1)
        assert len(bridge.trace(5)) == 5


def test_a_target_of_an_engagement_that_has_ended_is_never_sent() -> None:
    with arm() as bridge:
        bridge.stream_j(0.001 * ONE_JOINT)  # no tick comes before the end
        bridge.disengage()
        bridge.engage()
        state = bridge.step(10)
        assert state.stream_j_sends == 0
        assert np.all(state.q_target == state.q)


def test_engaging_anew_forgets_the_target_that_was_still_to_come() -> None:
    with arm() as bridge:
        bridge.stream_j(0.001 * ONE_JOINT)
        bridge.step(1)
        bridge.stream_j(0.002 * ONE_JOINT)  # waits for its turn
        bridge.step(1)
        bridge.disengage()
        bridge.step(30)
        q = bridge.engage()
        state = bridge.step(10)
        assert state.stream_j_sends == 1
        assert state.q_target[0] == q[0] == 0.001
