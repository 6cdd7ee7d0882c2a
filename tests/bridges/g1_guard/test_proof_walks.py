"""Six recorded walks by two policies, over the wire, through guard and twin, in real time: as good as in simulation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import mean

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.policies.twist2 import Twist2Policy
from station.bus import keys
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.life.server import decode_health
from tests.bridges.g1_guard.bench import guarded
from tests.cli.running import Home, new_home
from tests.figures import Figures
from tests.main_job.test_motions import SHIPPED

pytestmark = [pytest.mark.timeout(900), pytest.mark.assets]

OF_POLICY = {
    "tracker": (),
    "twist2": (
        "robot.policies.tracker.policy=twist2", "robot.policy_options.of=twist2",
        f"robot.checkpoint={Twist2Policy.CHECKPOINT}",
    ),
}  # fmt: skip
WORSE = 1.10
RUNS = 4


@pytest.fixture
def home(processes: None, assets: Path) -> Iterator[Home]:
    assert assets
    with new_home() as found:
        yield found


def _recorded(home: Home, runbook: str, task: str, *settings: str) -> float:
    """Run a runbook unattended; return the mean joint error of its robot [rad]."""
    sets = [word for setting in settings for word in ("--set", setting)]
    done = home.run("up", runbook, "--yes", "--record", "--task", task, *sets)
    assert done.returncode == 0, done.stderr
    found = home.json("check", str(home.episode(task)))
    assert found["falls"] == 0, task
    (steps,) = found["steps"]
    return float(steps["mean_joint_error_rad"])


def _falls_of_twin(folder: Path) -> int:
    """Return how many falls the twin counted, by the height of its pelvis.

    `station check` sees only how far a robot leans; one that hangs in its rope stays upright.
    """
    newest = None
    for message in EpisodeReader(signals_file(folder)).messages([keys.server("twin")]):
        newest = decode_health(message.data) or newest
    assert newest is not None
    return int(newest.detail["falls"])


@pytest.mark.parametrize("motion", SHIPPED, ids=lambda motion: Path(motion).stem[-3:])
@pytest.mark.parametrize("policy", OF_POLICY)
def test_a_walk_over_the_wire_is_as_good_as_in_simulation(
    policy: str, motion: str, home: Home, plain: Path, proof: Figures
) -> None:
    errors: dict[str, list[float]] = {"simulated": [], "real": []}
    for number in range(RUNS):  # no two in real time are alike: a simulation differs from itself by 5 %
        plays = f"motion.motion={motion}"
        errors["simulated"].append(
            _recorded(home, "g1-sim-motion", f"simulated-{number}", plays, f"g1.policy={policy}")
        )  # fmt: skip
        with guarded(plain) as (_, options):
            errors["real"].append(
                _recorded(home, "g1-twin-motion", f"real-{number}", plays, *options, *OF_POLICY[policy])
            )  # fmt: skip
        assert _falls_of_twin(home.episode(f"real-{number}")) == 0
    ratio = mean(errors["real"]) / mean(errors["simulated"])
    proof.figure(
        f"G1 over the wire, {policy} on walk {Path(motion).stem[-3:]}: mean joint error, of the simulation's",
        ratio, "", f"≤ {WORSE}",
    )  # fmt: skip
    assert ratio <= WORSE
