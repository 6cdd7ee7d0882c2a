"""A session that refuses, or takes no more by itself: told once, and nothing moves because a reason went away."""

from __future__ import annotations

import numpy as np

from tests.control.arm_bench import STEP, Bench


def test_a_session_that_refuses_targets_is_told_once_and_nothing_is_taken_for_sent() -> None:
    bench = Bench()
    command = bench.drive(10)
    for number in range(10):  # each time with other numbers in its reason
        bench.arm.refusal = f"joint 1 at 6.{number} rad is out of its limits"
        record = bench.step(command + STEP)
        assert (record.is_sent, record.refusal) == (False, bench.arm.refusal)
        np.testing.assert_array_equal(record.target, command)
    assert bench.names().count("target-refused") == 1
    bench.arm.refusal = ""
    record = bench.step(command + STEP)
    assert (record.is_sent, record.refusal) == (True, "")
    bench.arm.refusal = "again"
    bench.step(command)
    assert bench.names().count("target-refused") == 2


def test_a_session_that_cannot_be_engaged_is_asked_once_and_told_of_once_until_commands_begin_anew() -> None:
    bench = Bench()
    bench.arm.refusal = "not now"
    told = ["gate", "gate", "engage-refused", "gate"]  # it entered and tracked, and waits again
    for _ in range(100):
        record = bench.step(bench.arm.q.copy())
    assert bench.names() == told
    assert record.decision.reason == "not now; let go, then engage anew"
    bench.arm.refusal = ""
    bench.drive(100)  # by who never let go
    assert (bench.state, bench.arm.engaged_at, bench.arm.sent) == ("waiting", [], [])
    assert bench.names() == told
    bench.steps(0.4)
    bench.step(bench.arm.q.copy())
    assert bench.state == "tracking"
    assert len(bench.arm.engaged_at) == 1


def test_each_new_try_to_engage_is_told_when_it_is_refused() -> None:
    bench = Bench()
    bench.arm.refusal = "not now"
    for _ in range(2):
        bench.steps(0.1, bench.arm.q.copy())
        bench.steps(0.4)
    assert bench.names().count("engage-refused") == 2


def test_a_session_that_takes_no_more_targets_by_itself_is_released_and_who_drove_has_to_let_go() -> None:
    bench = Bench()
    command = bench.drive(50)
    sent = len(bench.arm.sent)
    bench.arm.is_engaged = False  # as when somebody clears faults that there are none of
    record = bench.step(command)
    assert (bench.state, bench.arm.releases) == ("waiting", 1)
    assert record.decision.reason == "the controller's session takes no more targets; let go, then engage anew"
    assert bench.names().count("engagement-lost") == 1
    command = bench.drive(200, command)
    assert (len(bench.arm.sent), len(bench.arm.engaged_at)) == (sent, 1)
    assert bench.names().count("engagement-lost") == 1
    bench.steps(0.4)
    bench.drive(10)
    assert len(bench.arm.sent) == sent + 10


def test_where_the_session_could_take_no_target_nobody_is_followed_and_the_reason_is_told() -> None:
    bench = Bench()
    bench.arm.why_blocked = "joint_1 is 0.1 rad outside its range"
    record = bench.step(bench.arm.q.copy())
    assert (record.decision.state, record.decision.reason) == ("waiting", bench.arm.why_blocked)
    assert bench.arm.engaged_at == []
    bench.arm.why_blocked = ""
    bench.drive(100)  # by who never let go
    assert (bench.state, bench.arm.engaged_at) == ("waiting", [])
    bench.steps(0.4)
    assert bench.step(bench.arm.q.copy()).decision.state == "tracking"
