"""Another program drives the twin, and ours refuses while it does (R3)."""

from __future__ import annotations

import subprocess
import threading
import time

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.robots.g1.dds.options import G1DdsOptions
from adapters.robots.g1.dds.robot import G1Dds
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.g1.twin.options import G1TwinOptions
from adapters.robots.g1.twin.twin import G1Twin
from tests.adapters.robots.g1.dds import far


def test_r3_another_program_drives_the_twin_and_ours_says_who_writes(processes):
    with far.running("client", 4.0) as child:
        twin = G1Twin(G1TwinOptions(is_released=True), G1Faults())
        ticking = threading.Thread(target=_tick, args=(twin, child))
        ticking.start()
        ours = G1Dds(G1DdsOptions(), 0.02)
        refusals, refused_first = set(), None
        try:
            while child.poll() is None:
                ours.read()
                refusals.add(ours.why_not_arm())
                if refused_first is None and twin.firmware.accepted:
                    refused_first = dict(twin.firmware.refused)
                time.sleep(0.02)
        finally:
            ticking.join()
            ours.close()
            twin.close()
        said = far.outcome(child)
    assert twin.firmware.accepted > 500, "it repeats its command at 500 Hz"
    assert twin.firmware.refused == refused_first, "nothing, once it knew the robot"
    assert set(refused_first) <= {"mode_machine"}, "until it has heard a state, it does not know that"
    assert said["mode_machine"] == 5
    assert said["states"] > 50
    assert any(f"(pid {child.pid})" in why and "another program writes rt/lowcmd" in why for why in refusals)


def _tick(twin: G1Twin, child: subprocess.Popen[str]) -> None:
    """Run a twin, more or less in real time, as long as another program does."""
    while child.poll() is None:
        twin.tick()
        time.sleep(0.0015)
