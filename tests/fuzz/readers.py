"""Every reader of recorded values, given an episode whose every value is a mutant of a good one."""

from __future__ import annotations

import random
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from adapters.policies.tracker.policy import TrackerPolicy
from adapters.robots.g1 import twist_keys
from station import assets
from station.api.episode import Episode
from station.bus import codec, contracts, keys, robot_streams
from station.config import to_plain
from station.contract import TIMING_STAGES
from station.control.gate import GateConfig
from station.enrich.enrich import enrich
from station.episode.quality.check import check, write_measured
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.replaying import arm_audit, replay
from station.episode.replaying.audit import audit
from station.errors import StationError
from station.export import columns, tracks, words
from station.report import story, tracking_plot
from station.view.run import read_run
from tests.adapters.exports.ros2.read_back import exported
from tests.episode.filming import cloud
from tests.episode.synthetic import EpisodeBuilder
from tests.fuzz.mutants import mutant
from tests.fuzz.parsers import ARM, CONFIG, EVENT, FORMATS, GATE, ROBOT, SOURCE, dumped
from tests.fuzz.shelf import Shelf

Values = dict[str, bytes]


class Reader(NamedTuple):
    """A reader of whole episodes; `modules` as of a parser. It may raise `StationError`."""

    name: str
    read: Callable[[EpisodeReader], object]
    modules: tuple[str, ...]


def _checked(reader: EpisodeReader) -> None:
    write_measured(reader.folder, check(reader))
    open_episode(reader.folder)


def _told(reader: EpisodeReader) -> None:
    tracking_plot.draw(story.read(reader), {})


def _numbers(reader: EpisodeReader) -> None:
    for topic in reader.topics():
        reader.json(topic)
        try:
            found = columns.key_columns(reader, topic)
            reader.vectors(topic)
        except StationError:
            continue
        tracks.read(reader, [found], ["camera_image_a"], words.spellings(ROBOT))


def _eased(reader: EpisodeReader) -> None:
    shelf = Shelf({keys.command_used(ARM): codec.f64(np.full(7, np.nan))})
    replay._blends(shelf, reader, 0.1)  # type: ignore[arg-type]


def _as_a_bag(reader: EpisodeReader) -> None:
    with tempfile.TemporaryDirectory() as folder:
        exported(reader.folder, Path(folder) / "bags")


@cache
def _policy() -> TrackerPolicy:
    return TrackerPolicy(assets.resolve("builtin:tracker.onnx"))


def _audited(reader: EpisodeReader) -> None:
    arm_audit.audit_arm(reader, ARM)
    audit(reader, policy=_policy(), robot=ROBOT)


def _in_a_notebook(reader: EpisodeReader) -> None:
    episode = Episode(reader)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # they tell of values that do not fit
        for key in episode.keys:
            episode.json(key)
            try:
                episode.numpy(key)
            except StationError:
                continue
        for lidar in episode.lidars:
            assert all(np.isfinite(points).all() for _, points in episode.clouds(lidar))
        for robot in (ROBOT, ARM):
            episode.steps(robot)


_QUALITY, _REPLAYING = "station.episode.quality.", "station.episode.replaying."
READERS = (
    Reader("check", _checked, (
        _QUALITY + "alignment", _QUALITY + "arms", _QUALITY + "check", _QUALITY + "policy_steps",
        _QUALITY + "presence", _QUALITY + "blocks", _QUALITY + "step_times", "station.episode.writing.file")),
    Reader("report", _told, ("station.report.story",)),
    Reader("show", read_run, ("station.view.phases",)),
    Reader("enrich", enrich, ("station.enrich.enrich", "station.enrich.siblings")),
    Reader("export", _numbers, ("station.export.tracks", "station.export.words", "station.episode.reading.reader")),
    Reader("ros2", _as_a_bag, ("adapters.exports.ros2.topics",)),
    Reader("notebook", _in_a_notebook, ("station.api.steps",)),
    Reader("replay", _eased, (_REPLAYING + "replay",)),
    Reader("audit", _audited, (
        _REPLAYING + "arm_audit", _REPLAYING + "audit", _REPLAYING + "gate_audit", _REPLAYING + "target_audit")),
)  # fmt: skip


def good() -> tuple[Values, Values]:
    """A state and the results of a policy step, every key with a good value."""
    rng = np.random.default_rng(0)
    state, results = {}, {}
    for contract in contracts.contracts():
        into = state if contract.role == "state" else results
        if contract.codec in ("f64", "f32") and contract.elements:
            numbers = rng.normal(size=len(contract.elements))
            into[contract.key] = codec.f64(numbers) if contract.codec == "f64" else codec.f32(numbers)
        elif contract.codec == "json-vector":
            into[contract.key] = codec.json_vector(rng.integers(1, 10**12, size=len(contract.elements)).tolist())
    for robot in (ROBOT, ARM):
        results[keys.command_gate(robot)] = dumped(GATE)
        results[keys.command_source(robot)] = dumped(SOURCE)
        results[keys.policy_timing(robot)] = codec.json_vector(range(1, 3 + len(TIMING_STAGES)))
    lengths = {keys.target: 7, keys.command_used: 7, keys.state_joints: 21}
    results |= {key(ARM): codec.f64(rng.normal(size=length)) for key, length in lengths.items()}
    results[keys.state_counters(ARM)] = codec.f64(np.arange(len(robot_streams.COUNTERS + robot_streams.SESSION_TIMES)))
    results[keys.state_controller(ARM)] = dumped({"backend": "sim", "profile": "a", "lead_rad": 0.1})
    results[keys.lidar_cloud("a")] = cloud(1, 20)
    results[keys.action_joints(ARM)] = codec.json_vector(np.zeros(7))
    return state, results


def episode_of_mutants(data: Path, steps: int, seed: str) -> Path:
    """Record some hundred steps, every second value of which is damaged; return the folder."""
    builder = EpisodeBuilder(data)
    state, results = good()
    rng = random.Random(f"{seed}/episode")
    for step in range(steps):
        at_s = 0.02 * step
        builder.write(dict(_damaged(state, rng)), at_s=at_s)
        builder.write(dict(_damaged(results, rng)), at_s=at_s + 0.005)
        for key, value in ((keys.EVENT, EVENT.encode()), (keys.server_config("g1"), dumped(CONFIG))):
            builder.write({key: mutant(value, rng)}, at_s=at_s + 0.01)
        builder.foreign(twist_keys.action_body(ROBOT), mutant(b"[0.0, 1.0]", rng), at_s=at_s + 0.011)
    arm = {"robot": ARM, "gate": to_plain(GateConfig()), "command": {
        name: getattr(FORMATS[-1], name).tolist() for name in ("lower", "upper", "margin", "rate")}}  # fmt: skip
    return builder.finish({"robot": {"suffix": ROBOT}, "servers": {"g1": CONFIG, "arm": arm}})


def _damaged(values: Values, rng: random.Random) -> Iterator[tuple[str, bytes]]:
    for key, value in values.items():
        yield key, mutant(value, rng) if rng.random() < 0.5 else value
