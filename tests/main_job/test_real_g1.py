"""A motion drives a G1 over its own network, from the gantry to the walk, by the runbook that ships (R20)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from station.api.episode import open_episode
from station.view.run import read_run
from tests.cli.running import Home, new_home
from tests.dds_domains import domain

ROBOT = "unitree_g1_with_hands"
pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def walked(processes: None, real_time: None) -> Iterator[Home]:
    """A place where the twin walked, recorded."""
    with new_home() as home, domain() as number:
        settings = (f"twin.options.domain={number}", f"robot.robot_options.domain={number}", "motion.leave_s=0.5")
        sets = [word for setting in settings for word in ("--set", setting)]
        done = home.run("up", "g1-twin-motion", "--yes", "--record", "--task", "walk", *sets)
        assert done.returncode == 0, done.stderr
        yield home


def test_it_walks_without_a_fall_and_every_step_is_what_the_policy_says(walked: Home) -> None:
    found = walked.json("check", "latest")
    assert (found["falls"], sum(stream["lost"] for stream in found["streams"])) == (0, 0)
    (steps,) = found["steps"]
    assert steps["gate_shares"]["tracking"] > 0.2
    assert steps["missing_steps"] == 0
    audited = walked.json("audit", "latest")
    assert (audited["different"], audited["observations"]["different"], audited["targets"]["different"]) == (0, 0, 0)
    assert audited["steps"] > 500
    assert [each["policy"] for each in audited["took_over"]] == ["tracker"]
    assert read_run(open_episode(walked.episode("walk"))._reader).policy == "tracker", "in the title of its pictures"


def test_every_state_that_the_robot_sent_is_in_the_episode(walked: Home) -> None:
    episode = open_episode(walked.episode("walk"))
    ticks = episode.numpy("state_samples", "tick").values[:, 0]
    assert (np.diff(ticks) == 2.0).all(), "500 a second, by the robot's own clock, none lost and none twice"
    seconds = (ticks[-1] - ticks[0]) / 1000.0
    assert abs(len(ticks) - 1 - 500.0 * seconds) <= 1.0
    assert seconds > 10.0
    warmest = episode.numpy("state_samples", "*_winding")
    assert warmest.values.shape == (len(ticks), 29)
    assert set(warmest.units) == {"degC"}
    assert (warmest.values > 20.0).all()
    assert len(episode.numpy("state_battery", "soc").values) > 50
