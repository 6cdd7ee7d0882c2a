from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from mcap.reader import make_reader
from rerun.chunk import McapReader

from adapters.exports.jointstate import SCHEMA_NAME, JointStates
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station.bus import keys
from station.episode.reading.reader import open_episode
from station.errors import EpisodeError
from station.export.columns import KeyColumns
from tests.adapters.exports.quick_looks import converted
from tests.enrich.recordings import walked
from tests.episode.synthetic import ROBOT

STATE, COMMAND = keys.robot_state(ROBOT), twist_keys.action_body()


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """An episode, and its joints."""
    folder = tmp_path_factory.mktemp("joints")
    episode = walked(folder / "data")
    converted("jointstate-mcap", episode, folder / "out")
    return episode, folder / "out" / f"{episode.name}.mcap"


def column(stream: Any, entity: str, component: str) -> list[Any]:
    found: list[Any] = []
    for chunk in stream:
        batch = pyarrow.record_batch(chunk.to_record_batch())
        if str(chunk.entity_path) == entity and component in batch.schema.names:
            found += batch.column(component).to_pylist()
    return found


def test_rerun_draws_every_joint_under_its_own_name_without_any_code(exported: tuple[Path, Path]) -> None:
    episode, path = exported
    stream = list(McapReader(path).stream())
    recorded = open_episode(episode).vectors(STATE).values
    for quantity, first in (("position", 0), ("velocity", 29)):
        entity = f"/{STATE}/{quantity}"
        assert set(map(tuple, column(stream, entity, "SeriesLines:names"))) == {G1_29}
        assert column(stream, entity, "Scalars:scalars") == recorded[:, first : first + 29].tolist()
    command = column(stream, f"/{COMMAND}/position", "Scalars:scalars")
    assert command == open_episode(episode).vectors(COMMAND).values[:, 6:].tolist()


@pytest.mark.usefixtures("processes")
def test_rerun_finds_the_file_sound(exported: tuple[Path, Path]) -> None:
    command = [sys.executable, "-m", "rerun", "mcap", "check", "--full", str(exported[1])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_messages_are_ros_joint_states_byte_by_byte_with_the_times_of_the_recording(
    exported: tuple[Path, Path],
) -> None:
    episode, path = exported
    recorded = [m for m in open_episode(episode).messages([STATE])]
    with path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages(topics=[STATE], log_time_order=False))
    assert [(m.log_time, m.publish_time, m.sequence) for _, _, m in found] == [
        (m.log_ns, m.publish_ns, m.sequence) for m in recorded
    ]
    schema, channel, message = found[3]
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (SCHEMA_NAME, "ros2msg", "cdr")
    read = Cdr(message.data)
    stamp_ns = read.one("i") * 1_000_000_000 + read.one("I")
    assert (stamp_ns, read.text()) == (message.publish_time, "")
    assert [read.text() for _ in range(read.one("I"))] == list(G1_29)
    values = open_episode(episode).vectors(STATE).values[3]
    assert np.array_equal(read.doubles(), values[:29])
    assert np.array_equal(read.doubles(), values[29:58])
    assert read.doubles() == []
    assert read.is_at_end


@pytest.mark.parametrize("joints_of_a_key", [("a",), ("abcd",), ("abcd", "efgh"), ("a", "abcdefg", "abc")])
def test_numbers_are_aligned_whatever_the_names_of_the_joints_are(joints_of_a_key: tuple[str, ...]) -> None:
    count = len(joints_of_a_key)
    names = tuple(f"{joint}{ending}" for ending in ("_vel", "_pos", "_torque") for joint in joints_of_a_key)
    units = ("rad/s",) * count + ("rad",) * count + ("N m",) * count
    made = JointStates.of(KeyColumns(key="key", role="state", codec="f64", names=names, units=units))
    assert made is not None
    values = [float(number) for number in range(len(names))]
    read = Cdr(made.encode(values, 5_000_000_007))
    assert (read.one("i"), read.one("I"), read.text()) == (5, 7, "")
    assert tuple(read.text() for _ in range(read.one("I"))) == joints_of_a_key
    assert (read.doubles(), read.doubles(), read.doubles()) == (
        values[count : 2 * count], values[:count], values[2 * count :]
    )  # fmt: skip
    assert read.is_at_end


def test_a_key_without_joints_is_left_out_or_refused_when_it_is_asked_for(
    exported: tuple[Path, Path], tmp_path: Path
) -> None:
    episode, path = exported
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    held = {channel.topic for channel in summary.channels.values()}
    assert {STATE, COMMAND, keys.command_used(ROBOT), keys.sim_qpos(ROBOT)} <= held
    assert keys.policy_timing(ROBOT) not in held
    with pytest.raises(EpisodeError, match=f"key '{keys.policy_timing(ROBOT)}' holds no joint positions; leave it out"):
        converted("jointstate-mcap", episode, tmp_path / "out", keys.policy_timing(ROBOT))


class Cdr:
    """Reads little-endian CDR: every number is aligned to its size, counted from behind the head."""

    def __init__(self, data: bytes) -> None:
        assert data[:4] == b"\x00\x01\x00\x00"
        self._body, self._at = data[4:], 0

    def one(self, code: str) -> Any:
        size = struct.calcsize(code)
        self._at += -self._at % size
        (value,) = struct.unpack_from(f"<{code}", self._body, self._at)
        self._at += size
        return value

    def text(self) -> str:
        length = self.one("I")
        raw = self._body[self._at : self._at + length]
        self._at += length
        assert raw[-1:] == b"\x00"
        return raw[:-1].decode()

    def doubles(self) -> list[float]:
        return [self.one("d") for _ in range(self.one("I"))]

    @property
    def is_at_end(self) -> bool:
        return self._at == len(self._body)
