"""A policy of another project, by LCM's own library, walks our robot; killed and frozen, it leaves one that stands.

By the clock, for most of a minute: on a busy machine a policy that comes back is late, so this is no part of every run.
"""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.adapters.lcm.library import expect_library
from tests.figures import Figures
from tests.main_job.test_lcm import FROZEN_S, WALKS_S, run, walked_m


@pytest.mark.assets
def test_our_robot_walks_by_a_policy_of_others_and_stands_by_itself_when_that_is_killed_or_frozen(
    proof: Figures, tmp_path: Path, processes: None, assets: Path
) -> None:
    expect_library()
    network = assets / "zoo/policies/rlgym_g1_motion.pt"
    words = [sys.executable, "-m", "tests.servers.homie_policy", str(network), "0.4"]
    with run(tmp_path, "robot.robot_options.armature=0") as made:
        with made.policy(words):
            made.await_said("runs")
            time.sleep(WALKS_S)
        time.sleep(3.0)  # killed in mid-walk
        with made.policy(words) as policy:
            made.await_said("runs", 2)
            time.sleep(WALKS_S / 2)
            policy.send_signal(signal.SIGSTOP)
            time.sleep(FROZEN_S)
            policy.send_signal(signal.SIGCONT)
            time.sleep(1.0)
        episode = made.end()
    events = [record.value for record in episode.events()]
    named = [event["name"] for event in events]
    told = [index for index, name in enumerate(named) if name in ("lcm-live", "lcm-silent", "lcm-back")]
    assert [named[index] for index in told][:5] == ["lcm-live", "lcm-silent", "lcm-back", "lcm-silent", "lcm-back"]
    assert "fall" not in named[: told[4]], "whether the network walks on after it was frozen is its own affair"
    assert events[told[4]]["detail"]["silent_s"] == pytest.approx(FROZEN_S + 0.2, abs=0.7)
    assert walked_m(episode) > 1.5
    proof.figure(
        "a robot that another project's policy drives over LCM walks, with a kill and a freeze", walked_m(episode), "m"
    )
    used, truth = episode.numpy("command_used_g1_29_legs"), episode.numpy("sim_qpos_g1_29")
    before_s = (events[told[4]]["wall_ns"] - episode.wall_ns(truth.written_s)) * 1e-9
    frozen = (before_s > 0.5) & (before_s < 1.0)
    assert np.ptp(truth.values[frozen, :2], axis=0).max() < 0.05, "it stands"
    assert {float(used.values[np.searchsorted(used.written_s, at_s), -1]) for at_s in truth.written_s[frozen]} == {0.0}
    assert np.mean(used.values[:, -1] == 1.0) > 0.2
