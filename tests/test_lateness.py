"""What excuses a promise about time: a proven wait and nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from station.episode.quality.findings import Quality, Reason, StreamQuality
from tests.late_verdicts import expect_no_worse_in_time
from tests.lateness import EXCUSED, PROOF_S, TooLate, Waits, excuse, in_time
from tests.verdicts import expect_no_worse_but_late

pytestmark = pytest.mark.usefixtures("processes")

CPU_S = 0.3
_SPIN = f"""
import os, time
os.sched_setaffinity(0, {{min(os.sched_getaffinity(0))}})
while time.process_time() < {CPU_S}: pass
"""


@pytest.mark.usefixtures("processes")
@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="this kernel does not tell who waited")
def test_processes_that_share_a_processor_wait_for_each_other() -> None:
    with Waits.watched() as waits:
        spinning = [subprocess.Popen([sys.executable, "-c", _SPIN]) for _ in range(3)]
        assert [process.wait() for process in spinning] == [0, 0, 0]
    assert waits.seconds() > CPU_S, "two of them waited for the first"
    assert 0.0 < waits.longest_s <= waits.seconds()


def test_what_is_asked_again_waited_for_longer_than_it_was_late(caplog: pytest.LogCaptureFixture) -> None:
    late = [TooLate("a trial of excuses", 0.5, 0.6), TooLate("another", 0.0, PROOF_S)]
    left = list(late)

    def trial() -> str:
        if left:
            raise left.pop(0)
        return "in time"

    assert in_time(trial) == "in time"
    assert caplog.messages == [f"{EXCUSED}: {one}" for one in late]


@pytest.mark.parametrize(("late_s", "waited_s"), [(0.5, 0.4), (0.0, PROOF_S / 2), (0.02, 0.0)])
def test_who_was_late_and_did_not_wait_for_as_long_is_not_excused(late_s: float, waited_s: float) -> None:
    asked = []

    def trial() -> None:
        asked.append(1)
        raise TooLate("a stop", late_s, waited_s)

    with pytest.raises(TooLate, match="a stop: late by "):
        in_time(trial)
    assert len(asked) == 1
    with pytest.raises(TooLate):
        excuse(TooLate("a stop", late_s, waited_s))


def test_a_machine_that_is_late_in_every_round_is_no_excuse() -> None:
    asked = []

    def trial() -> None:
        asked.append(1)
        raise TooLate("a trial of excuses", 0.1, 1.0)

    with pytest.raises(TooLate):
        in_time(trial, rounds=3)
    assert len(asked) == 3


def test_a_wrong_result_is_never_a_late_one() -> None:
    def trial() -> None:
        assert os.getpid() == 0, "wrong"

    with pytest.raises(AssertionError, match="wrong") as caught:
        in_time(trial)
    assert not isinstance(caught.value, TooLate)


def test_a_rejected_episode_is_excused_for_a_gap_that_somebody_waited_for_and_for_no_fall() -> None:
    gap, fall = Reason("gap", "reject", "silent for 2 s"), Reason("fell", "reject", "1 fall(s)")
    stream = StreamQuality(
        key="k", source="s", writer="s", role="command", is_native=True, count=9, lost=0, repeated=0, out_of_order=0,
        rate_hz=50.0, nominal_hz=50.0, jitter_p50_s=0.0, jitter_p99_s=0.0, longest_gap_s=2.0, gap_at_s=1.0,
        first_s=0.0, last_s=9.0,
    )  # fmt: skip
    waits = Waits()
    waits.longest_s = 1.5
    with pytest.raises(TooLate) as caught:
        expect_no_worse_in_time("usable", Quality(episode_id="e", reasons=[gap], streams=[stream]), waits)
    assert caught.value.is_of_the_machine
    waits.longest_s = 0.0
    with pytest.raises(TooLate) as caught:
        expect_no_worse_in_time("usable", Quality(episode_id="e", reasons=[gap], streams=[stream]), waits)
    assert not caught.value.is_of_the_machine
    with pytest.raises(AssertionError) as wrong:
        expect_no_worse_in_time("usable", Quality(episode_id="e", reasons=[gap, fall], streams=[stream]), waits)
    assert not isinstance(wrong.value, TooLate)
    expect_no_worse_in_time("usable", Quality(episode_id="e", reasons=[Reason("slow", "usable", "40 Hz")]), waits)


def test_where_lateness_is_not_asked_for_a_gap_says_nothing_and_a_fall_rejects() -> None:
    gap, fall = Reason("gap", "reject", "silent for 2 s"), Reason("fell", "reject", "1 fall(s)")
    expect_no_worse_but_late("usable", Quality(episode_id="e", reasons=[gap]))
    with pytest.raises(AssertionError):
        expect_no_worse_but_late("usable", Quality(episode_id="e", reasons=[gap, fall]))
