from __future__ import annotations

from pathlib import Path

import numpy as np

from station.bus import keys
from station.bus.contracts import contract
from station.episode.reading.reader import open_episode
from tests.adapters.exports.quick_looks import converted
from tests.enrich.recordings import walked
from tests.episode.synthetic import ROBOT, WALL_START_NS

STATE = keys.robot_state(ROBOT)


def test_arrays_names_units_and_times_of_each_key_open_without_pickle(tmp_path: Path) -> None:
    episode = walked(tmp_path / "data")
    made = converted("npz", episode, tmp_path / "out")
    (path,) = (tmp_path / "out").iterdir()
    assert path.name == f"{episode.name}.npz"
    described, recorded = contract(STATE), open_episode(episode).vectors(STATE)
    assert described is not None
    with np.load(path, allow_pickle=False) as found:
        assert np.array_equal(found[STATE], recorded.values)
        assert tuple(found[f"{STATE}.names"]) == described.names
        assert tuple(found[f"{STATE}.units"]) == tuple(element.unit for element in described.elements)
        assert np.allclose(found[f"{STATE}.log_time_s"], (recorded.log_ns - WALL_START_NS) * 1e-9, atol=1e-9)
        assert np.allclose(found[f"{STATE}.publish_time_s"], (recorded.publish_ns - WALL_START_NS) * 1e-9, atol=1e-9)
        assert found[f"{STATE}.sequence"].tolist() == list(range(1, 51))
        assert (str(found["episode_id"]), str(found["task"]), int(found["start_ns"])) == (
            episode.name, "walk", WALL_START_NS
        )  # fmt: skip
        of_keys = [name for name in found.files if f"{name}.names" in found.files]
        assert sorted(of_keys) == sorted(made.facts["keys"])
        assert sum(len(found[name]) for name in of_keys) == made.rows


def test_the_same_episode_gives_the_same_bytes(tmp_path: Path) -> None:
    episode = walked(tmp_path / "data", seconds=0.2)
    for place in ("one", "two"):
        converted("npz", episode, tmp_path / place)
    name = f"{episode.name}.npz"
    assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
