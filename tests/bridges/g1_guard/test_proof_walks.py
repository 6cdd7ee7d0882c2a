"""Six recorded walks by two policies, over the wire, through guard and twin, in real time: as good as in simulation."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.policies.twist2 import Twist2Policy
from tests.cli.running import Home, new_home
from tests.dds_domains import domain
from tests.figures import Figures
from tests.main_job.test_motions import SHIPPED

pytestmark = [pytest.mark.timeout(600), pytest.mark.assets]

OF_POLICY = {
    "tracker": (),
    "twist2": (
        "robot.policies={tracker: {policy: twist2}}", "robot.policy_options.of=twist2",
        f"robot.checkpoint={Twist2Policy.CHECKPOINT}",
    ),
}  # fmt: skip
WORSE = 1.10


@pytest.fixture
def home(processes: None, assets: Path) -> Iterator[Home]:
    assert assets
    with new_home() as found:
        yield found


def _recorded(home: Home, runbook: str, task: str, *settings: str) -> dict[str, Any]:
    """Run a runbook unattended; return what is measured of its robot's steps."""
    sets = [word for setting in settings for word in ("--set", setting)]
    done = home.run("up", runbook, "--yes", "--record", "--task", task, *sets)
    assert done.returncode == 0, done.stderr
    found = home.json("check", str(home.episode(task)))
    assert found["falls"] == 0, task
    (steps,) = found["steps"]
    return steps


@pytest.mark.parametrize("motion", SHIPPED, ids=lambda motion: Path(motion).stem[-3:])
@pytest.mark.parametrize("policy", OF_POLICY)
def test_a_walk_over_the_wire_is_as_good_as_in_simulation(
    policy: str, motion: str, home: Home, plain: Path, proof: Figures
) -> None:
    simulated = _recorded(home, "g1-sim-motion", "simulated", f"motion.motion={motion}", f"g1.policy={policy}")
    with domain() as number, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        with subprocess.Popen([str(plain), "--domain", str(number), "--port", str(port)]) as guard:
            try:
                real = _recorded(
                    home, "g1-twin-motion", "real", f"motion.motion={motion}", f"twin.options.domain={number}",
                    f"robot.robot_options.domain={number}", "robot.robot_options.guard=127.0.0.1",
                    f"robot.robot_options.guard_port={port}", *OF_POLICY[policy],
                )  # fmt: skip
            finally:
                guard.terminate()
    errors = [each["mean_joint_error_rad"] for each in (simulated, real)]
    proof.figure(
        f"G1 over the wire, {policy} on walk {Path(motion).stem[-3:]}: mean joint error, of the simulation's",
        errors[1] / errors[0], "", f"≤ {WORSE}",
    )  # fmt: skip
    assert errors[1] <= WORSE * errors[0]
