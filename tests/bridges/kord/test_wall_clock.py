"""The loop in real time: K12 and K14 of the table. What it may not have it does without, and says so."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from station_kord import KordBridge, SimOptions

from tests.bridges.kord.arms import LIMITS, ONE_JOINT, PATIENT
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

WITHOUT_RIGHTS = """
import json, os, resource, sys
from station_kord import KordBridge, Limits, SimOptions
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
if os.getuid() == 0:
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
sim = SimOptions()
limits = Limits(q_min=sim.q_min, q_max=sim.q_max, qd_max=(2.0,) * 7, qdd_max=(10.0,) * 7)
with KordBridge(limits=limits, sim=sim, real_time_priority=70, lock_memory=True) as bridge:
    first = bridge.connect().tick
    while bridge.get_state().tick < first + 50:
        pass
    state = bridge.get_state()
    json.dump({"fifo": state.sched_fifo_granted, "locked": state.memory_locked, "told": bridge.real_time}, sys.stdout)
"""

WITH_LOCKED_MEMORY = """
import json, sys
from pathlib import Path
from station_kord import KordBridge, Limits, SimOptions
def locked_kb():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck"))
sim = SimOptions()
limits = Limits(q_min=sim.q_min, q_max=sim.q_max, qd_max=(2.0,) * 7, qdd_max=(10.0,) * 7)
with KordBridge(limits=limits, sim=sim, lock_memory=True) as bridge:
    bridge.connect()
    during = {"told": bridge.get_state().memory_locked, "during_kb": locked_kb()}
json.dump(during | {"after_kb": locked_kb(), "told_after": bridge.get_state().memory_locked}, sys.stdout)
"""

WHERE_TWO_ANSWER = """
import ctypes, json, os, sys
from station_kord import KordBridge, Limits, SimOptions
by_library, by_kernel = (int(word) for word in sys.argv[1:])  # priorities of SCHED_FIFO; 0 for normal scheduling
def policy_of(priority):
    return os.SCHED_FIFO if priority else os.SCHED_OTHER
library = ctypes.CDLL(None)
library.pthread_self.restype = ctypes.c_ulong
library.pthread_setschedparam.argtypes = [ctypes.c_ulong, ctypes.c_int, ctypes.POINTER(ctypes.c_int)]
priority = ctypes.byref(ctypes.c_int(by_library))
error = library.pthread_setschedparam(library.pthread_self(), policy_of(by_library), priority)
if error:
    sys.exit(os.strerror(error))
try:
    os.sched_setscheduler(0, policy_of(by_kernel), os.sched_param(by_kernel))
except PermissionError as problem:
    sys.exit(problem.strerror)
sim = SimOptions()
limits = Limits(q_min=sim.q_min, q_max=sim.q_max, qd_max=(2.0,) * 7, qdd_max=(10.0,) * 7)
with KordBridge(limits=limits, sim=sim, real_time_priority=0) as bridge:
    bridge.connect()
    json.dump({"fifo": bridge.get_state().sched_fifo_granted, "told": bridge.real_time}, sys.stdout)
"""
"""What the C library keeps of the main thread, and hands on to those that it starts, is not what the kernel does."""


def test_k12_the_loop_keeps_250_hz_and_sends_at_once() -> None:
    with KordBridge(limits=LIMITS, sim=PATIENT) as bridge:
        bridge.connect()
        q = bridge.engage()
        rates: list[float] = []
        before = bridge.get_state()

        def measured() -> bool:
            nonlocal before
            target = q + 0.05 * np.sin(bridge.get_state().tick * 0.02) * ONE_JOINT
            bridge.stream_j(target)
            now = bridge.get_state()
            if now.tick - before.tick >= 500:
                rates.append((now.tick - before.tick) / ((now.mono_ns - before.mono_ns) * 1e-9))
                before = now
            return len(rates) >= 5 and abs(np.median(rates) - 250) < 5 and now.sync_to_send_us.p50 < 100

        wait_until(measured, timeout_s=90)
        assert bridge.get_state().events == ()


def test_k14_without_rights_the_request_is_told_as_not_granted_and_the_loop_runs() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_RIGHTS], capture_output=True, text=True, timeout=60, check=False
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["fifo"], told["locked"]) == (False, False)
    assert told["told"].startswith("normal scheduling (Operation not permitted), memory not locked (")


def test_memory_is_locked_no_longer_than_the_session_lasts() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITH_LOCKED_MEMORY], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["during_kb"] > 0) == told["told"]
    assert (told["after_kb"], told["told_after"]) == (0, False)


def test_no_priority_asked_for_is_none_tried() -> None:
    with KordBridge(limits=LIMITS, sim=SimOptions(), real_time_priority=0) as bridge:
        bridge.connect()
        assert bridge.real_time == "normal scheduling"


@pytest.mark.parametrize(
    ("by_library", "by_kernel", "told"), [(99, 0, "normal scheduling"), (0, 1, "SCHED_FIFO 1")], ids=["gone", "given"]
)
def test_the_scheduling_that_is_told_is_the_kernels_and_not_what_a_library_once_asked_for(
    by_library: int, by_kernel: int, told: str
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WHERE_TWO_ANSWER, str(by_library), str(by_kernel)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    if done.stderr.strip() == "Operation not permitted":
        pytest.skip("this user may not ask for SCHED_FIFO, so no library can have")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"fifo": by_kernel > 0, "told": told}


def test_a_python_that_does_not_come_round_leaves_the_arm_at_its_last_target() -> None:
    with KordBridge(limits=LIMITS, sim=PATIENT) as bridge:
        bridge.connect()
        q = bridge.engage() + 0.03 * ONE_JOINT
        bridge.stream_j(q)
        tick = bridge.get_state().tick
        wait_until(lambda: sum(range(3_000_000)) and bridge.get_state().tick > tick)  # busy, and holds its lock
        wait_until(lambda: abs(bridge.get_state().q[0] - q[0]) < 1e-9)
        assert bridge.get_state().stream_j_sends == 1
