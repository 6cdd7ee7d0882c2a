"""The guard as a process: on a robot's wire, with signals and with stations that die."""

from __future__ import annotations

import random
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from adapters.robots.g1.dds import guard_client
from adapters.robots.g1.dds.guard_client import MOTORS, Reason, Refusal, State
from tests.bridges.g1_guard.bench import Q, Sender
from tests.waiting import wait_until


@pytest.fixture(autouse=True)
def _healthy(request):
    if "bench" in request.fixturenames:
        request.getfixturevalue("bench").robot.reset()


def assert_damped(received) -> None:
    """Stiffness falls and never rises, nothing moves, and the last has none."""
    damping = next(i for i, each in enumerate(received) if each.is_damping)
    after = received[damping:]
    stiffness = np.array([each.kp for each in after])
    assert (np.diff(stiffness, axis=0) <= 0).all()
    assert stiffness[0].all(), "a ramp, not a step"
    assert not stiffness[-1].any()
    assert all(each.is_damping and (each.q == after[0].q).all() for each in after)


def test_a_robot_is_sent_nothing_before_arming_and_then_what_is_commanded(bench):
    wait_until(lambda: bench.status().states > 10)
    assert bench.status().state is State.WAITING
    bench.command(0.1)
    assert bench.robot.received == []
    bench.arm()
    last = bench.robot.received[-1]
    assert last.is_intact
    assert (last.record["mode_machine"], last.record["mode_pr"]) == (5, 0)
    assert bench.robot.modes(last) == [1] * MOTORS
    assert np.allclose(last.q, Q)
    assert not last.record["motors"]["dq"].any()
    assert not last.record["motors"]["tau"].any()
    assert not last.record["motors"]["kp"][MOTORS:].any()
    assert all(each.is_intact for each in bench.robot.received)
    assert bench.status().round_trip_ns > 0


def test_a_station_that_goes_silent_is_damped_until_it_arms_again(bench):
    received = bench.until_damping(Reason.SILENCE, lambda: None, commands=False)
    assert_damped(received)
    count = len(bench.robot.received)
    bench.command(0.3, q=-Q)
    returned = bench.robot.received[count:]
    assert len(returned) > 10
    assert not any(each.kp.any() for each in returned)
    bench.arm()
    assert bench.robot.received[-1].kp.all()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_station_that_is_killed_or_stopped_is_damped_and_its_return_moves_nothing(bench, how):
    wait_until(lambda: bench.status().state is not State.RAMPING)
    sender = Sender(bench.port)
    try:
        sender.wait_armed()
        wait_until(lambda: bench.robot.received and bench.robot.received[-1].kp.all())
        before = len(bench.robot.received)
        sender.signal(how)
        wait_until(lambda: bench.robot.received[-1].is_damping and not bench.robot.received[-1].kp.any())
        assert_damped(bench.robot.received[before:])
        if how is signal.SIGSTOP:
            before, refused = len(bench.robot.received), bench.status().refused[Refusal.NOT_ARMED]
            sender.signal(signal.SIGCONT)
            wait_until(lambda: bench.status().refused[Refusal.NOT_ARMED] > refused + 5)
            assert not any(each.kp.any() for each in bench.robot.received[before:])
    finally:
        sender.close()


def _set(bench, *path, value) -> None:
    array = bench.robot.state
    for name in path[:-1]:
        array = array[name]
    array[path[-1]] = value


OF_THE_WIRE = {
    "tilt": (lambda b: _set(b, "quat_wxyz", 0, value=(0.8, 0, 0.6, 0)), Reason.TILT),
    "winding": (lambda b: _set(b, "motors", "temperature", (0, 28, 1), value=120), Reason.WINDING),
    "casing": (lambda b: _set(b, "motors", "temperature", (0, 0, 0), value=85), Reason.CASING),
    "motor error": (lambda b: _set(b, "motors", "error", (0, 3), value=0x200), Reason.MOTOR_ERROR),
    "remote": (lambda b: _set(b, "remote", (0, slice(2, 4)), value=(0xFF, 0xFF)), Reason.REMOTE),
    "no states": (lambda b: setattr(b.robot, "is_sending", False), Reason.NO_STATE),
    "damaged states": (lambda b: setattr(b.robot, "is_signed", False), Reason.NO_STATE),
    "tick": (lambda b: setattr(b.robot, "is_ticking", False), Reason.TICK),
}


@pytest.mark.parametrize("what", OF_THE_WIRE)
def test_what_the_robot_says_ends_it(bench, what):
    act, reason = OF_THE_WIRE[what]
    assert_damped(bench.until_damping(reason, lambda: act(bench)))
    bench.robot.reset()


def test_a_guard_that_stood_still_itself_comes_to_damping(bench):
    def pause() -> None:
        bench.guard.send_signal(signal.SIGSTOP)
        bench.command(0.3)
        bench.guard.send_signal(signal.SIGCONT)

    assert_damped(bench.until_damping(Reason.LATE, pause))


def test_numbers_that_are_none_reach_no_motor(bench):
    q = Q.copy()
    q[3] = np.nan
    received = bench.until_damping(Reason.REFUSALS, lambda: bench.command(0.1, q=q))
    assert_damped(received)
    assert np.isfinite([each.q for each in received]).all()


def test_another_writer_is_named_and_refused(bench):
    script = (
        "from adapters.robots.g1.dds import network, types; "
        f"n = network.Network(network.NetworkOptions(domain={bench.number})); "
        "w = n.writer('rt/lowcmd', network.raw(types.LowCmd)); input(); n.close()"
    )
    children = []

    def appear() -> None:
        children.append(subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE))

    try:
        bench.arm()
        appear()
        wait_until(lambda: bench.command(0.04) or bench.status().foreign)
        assert f"(pid {children[0].pid}) on {socket.gethostname()}" in bench.status().foreign
        wait_until(lambda: bench.status().state is State.DAMPING)
        bench.client.arm()
        wait_until(lambda: bench.client.poll() and bench.client.why_not_armed)
        assert bench.client.why_not_armed is Reason.FOREIGN_WRITER
    finally:
        for child in children:
            child.communicate(b"\n")
    wait_until(lambda: not bench.status().foreign)


def test_of_100_000_random_datagrams_none_reaches_a_motor_and_the_guard_lives(bench):
    chance = random.Random(11)
    bench.until_damping(Reason.SILENCE, lambda: None, commands=False)
    before = len(bench.robot.received)
    enough = sum(bench.status().refused.values()) + 100_000
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(("127.0.0.1", bench.port))
        head = guard_client.command(Q, Q, Q, seq=9, state_tick=9, sender_ns=9, token=9)
        random_ones = [chance.randbytes(chance.choice((0, 1, 36, 383, 384, 385, 1400))) for _ in range(400)]
        mutants = [head[:place] + bytes([chance.randrange(256)]) + head[place + 1 :] for place in range(384)]
        pool = random_ones + mutants
        while sum(bench.client.status.refused.values()) < enough:  # those that no socket kept do not count
            for _ in range(100):
                stranger.send(chance.choice(pool))
            bench.client.poll()
            time.sleep(0.001)
            assert bench.guard.poll() is None
    status = bench.status()
    assert status.state is State.DAMPING
    assert not any(each.kp.any() for each in bench.robot.received[before:])
    bench.arm()


def test_a_guard_that_is_told_to_end_damps_first_and_forgets_that_it_was_armed(bench):
    bench.arm()
    assert bench.flag.read_bytes() == b"\1"
    before = len(bench.robot.received)
    bench.end()
    time.sleep(0.05)
    received = bench.robot.received[before:]
    assert_damped(received)
    ending = [each for each in received if each.is_damping and not each.kp.any()]
    assert len(ending) > 20, "150, but on a busy machine"
    assert bench.flag.read_bytes() == b"\0"
    assert "ramping: told to end" in bench.said or "damping: told to end" in bench.said
    bench.guard = bench.start()
    wait_until(lambda: bench.status().state is State.WAITING)


def test_a_guard_that_was_killed_while_armed_begins_with_damping(bench):
    bench.arm()
    bench.guard.kill()
    bench.guard.wait()
    before = len(bench.robot.received)
    bench.guard = bench.start()
    wait_until(lambda: len(bench.robot.received) > before + 20)
    said = bench.status()
    assert (said.state, said.reason) == (State.DAMPING, Reason.RESTARTED)
    assert not bench.robot.received[-1].kp.any()
    assert bench.robot.received[-1].is_damping
    wait_until(lambda: not bench.status().foreign, 30)  # the one that was killed is missed after ten seconds
