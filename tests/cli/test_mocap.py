"""``station up g1-sim-mocap`` as a newcomer runs it: a fake Motive's actor drives the simulated G1, recorded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from tests.cli.running import Home, new_home
from tests.verdicts import expect_no_worse_but_late

ROBOT = twist_keys.TWIST2_ROBOT


@pytest.fixture
def home(processes: None) -> Iterator[Home]:
    with new_home() as made:
        yield made


def test_an_actors_arms_move_the_robots_and_the_episode_is_good(home: Home, tmp_path: Path) -> None:
    pad = tmp_path / "pad.json"
    pad.write_text('{"device": "gamepad", "steps": [{"at_s": 2.0, "set": {"left_bumper": 1}}]}')
    done = home.run(
        "up", "g1-sim-mocap", "--yes", "--record", "--task", "mocap", "--for", "9s", "--set", f"gamepad.fake={pad}",
        "--set", "natnet.fake=builtin:natnet/example.json", "--set", "g1.gate.hold_after_s=1.5",
        "--set", "g1.gate.return_after_s=4",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "operator-engaged device=natnet driver=body" in done.stderr
    (folder,) = (home.data / "mocap").iterdir()
    reader = open_episode(folder)
    quality = check(reader)
    expect_no_worse_but_late("good", quality)
    assert reader.manifest.policy.name == "tracker"
    heads = reader.vectors(keys.operator_body_pos("natnet")).values
    assert np.ptp(heads, axis=0).max() > 0.2, "the actor waves"
    states = reader.vectors(twist_keys.state_body(ROBOT)).values
    assert np.ptp(states[len(states) // 2 :], axis=0).max() > 0.3, "and the robot does"
