"""Rerun itself reads what we write: headless, with its own reader of MCAP."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pyarrow
import pytest
from rerun.chunk import DeriveLens, McapReader

from station.bus import keys
from station.bus.contracts import contract
from station.enrich import source
from station.enrich.enrich import enrich
from station.episode.reading.reader import open_episode
from tests.enrich.read_back import topics
from tests.enrich.recordings import filmed, jpeg, walked
from tests.episode.synthetic import ROBOT

STATE = keys.robot_state(ROBOT)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = walked(tmp_path_factory.mktemp("data"))
    enrich(open_episode(made))
    return made


def column(stream: Any, entity: str, component: str) -> list[Any]:
    """Values of a component of an entity, row by row."""
    found: list[Any] = []
    for chunk in stream:
        batch = pyarrow.record_batch(chunk.to_record_batch())
        if str(chunk.entity_path) == entity and component in batch.schema.names:
            found += [value[0] for value in batch.column(component).to_pylist()]
    return found


def test_curves_are_named_as_the_contract_names_them(folder: Path) -> None:
    described, path = contract(STATE), folder / source.ENRICHED
    assert described is not None
    component = f"{topics(path)[f'{STATE}/typed']}:message"
    lenses = [DeriveLens(component, output_entity=f"/curves/{name}").to_scalars(name) for name in described.names]
    curves = list(McapReader(path, include_topic_regex=[f"^{STATE}/typed$"]).stream().lenses(lenses))
    assert {str(chunk.entity_path) for chunk in curves} == {f"/curves/{name}" for name in described.names}
    recorded = open_episode(folder).vectors(STATE).values
    for index, name in enumerate(described.names):
        assert column(curves, f"/curves/{name}", "Scalars:scalars") == recorded[:, index].tolist()


def test_scalars_of_json_come_with_their_names(folder: Path) -> None:
    path, topic = folder / source.ENRICHED, f"{keys.command_gate(ROBOT)}/typed"
    rows = column(McapReader(path).stream(), f"/{topic}", f"{topics(path)[topic]}:message")
    assert rows[0] == {"state": "tracking", "reason": "", "age_s": 0.004}


def test_events_poses_and_the_root_are_drawn_by_rerun_itself(folder: Path) -> None:
    stream = list(McapReader(folder / source.ENRICHED).stream())
    assert column(stream, "/station\\:event/log", "TextLog:text") == ["fall lean_rad=1.25"]
    (head,) = column(stream, f"/{keys.operator_head('pico')}/pose", "InstancePoses3D:translations")
    assert head == pytest.approx([0.1, -0.2, 1.6])
    root = column(stream, f"/{keys.sim_qpos(ROBOT)}/tf", "Transform3D:translation")
    assert [place[0] for place in root] == pytest.approx([0.02 * tick for tick in range(50)])


def test_pictures_are_pictures(tmp_path: Path) -> None:
    pictures, now = [jpeg(10), jpeg(200)], time.monotonic_ns()
    made = filmed(tmp_path / "film", pictures, [now - 40_000_000, now - 20_000_000])
    enrich(open_episode(made))
    entity = f"/{keys.camera_image('head')}/image"
    blobs = column(McapReader(made / source.ENRICHED).stream(), entity, "EncodedImage:blob")
    assert [bytes(blob) for blob in blobs] == pictures


@pytest.mark.usefixtures("processes")
def test_rerun_finds_the_file_sound(folder: Path) -> None:
    command = [sys.executable, "-m", "rerun", "mcap", "check", "--full", str(folder / source.ENRICHED)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
