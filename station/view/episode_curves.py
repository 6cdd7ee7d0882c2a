"""The curves of an episode: every vector with named elements, commanded against measured joints, latencies."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from station.bus import keys
from station.contract import TIMING_STAGES, Contract
from station.episode.reading.reader import EpisodeReader
from station.protocols import Floats
from station.view import curves
from station.view.layout import JOINTS, TIMELINE
from station.view.poses import Numbers

Ints = NDArray[np.int64]
_FIRST_STAGE = 2  # after tick and command_seq
_WIDTHS = {"commanded": 1.0, "measured": 2.0}


class Source:
    """What a view asks of an episode: vectors by key, and its time line.

    Args:
        reader: The episode.
    """

    def __init__(self, reader: EpisodeReader) -> None:
        self.reader = reader
        self.contracts: dict[str, Contract] = {
            stream.channel.topic: stream.channel.contract
            for stream in reader.streams()
            if stream.count and stream.channel.contract is not None and not stream.channel.is_deletion
        }
        self._start_ns = reader.start_ns
        self._cache: dict[str, Numbers | None] = {}

    def groups(self, robot: str) -> dict[str, tuple[str, ...]]:
        """Return the names of a robot's joints by limb; all as one where nothing says."""
        description = self.reader.known.robot(robot)
        if description is not None and description.groups:
            return description.groups
        used = self.contracts.get(keys.command_used(robot))
        names = used.names if used is not None else ()
        return {"joints": tuple(name.removesuffix("_pos") for name in names if name.endswith("_pos"))}

    def seconds(self, times_ns: Ints) -> Floats:
        """Return instants as seconds since the start of the episode."""
        return np.asarray((times_ns - self._start_ns) * 1e-9)

    def index(self, times_ns: Ints) -> list[rr.TimeColumn]:
        """Return instants as the time columns of a Rerun recording."""
        return [rr.TimeColumn(TIMELINE, duration=self.seconds(times_ns))]

    def vectors(self, key: str) -> Numbers | None:
        """Return the numbers of a key that has named elements and values, else None."""
        if key not in self._cache:
            self._cache[key] = self._read(key)
        return self._cache[key]

    def _read(self, key: str) -> Numbers | None:
        contract = self.contracts.get(key)
        if contract is None or not contract.elements:
            return None
        times_ns, _, values = self.reader.vectors(key)
        if not len(values):
            return None
        return Numbers(times_ns, np.asarray(values, dtype=np.float64), contract)


@dataclass
class DrawnCurves:
    """What was drawn: entities, contracts of their keys, limbs whose joints can be compared, and what was left out."""

    entities: list[str] = field(default_factory=list)
    contracts: list[Contract] = field(default_factory=list)
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def draw_curves(recording: rr.RecordingStream, source: Source, robot: str) -> DrawnCurves:
    """Send every vector whose elements have names, and what can be told from several of them."""
    drawn = DrawnCurves()
    for contract in curves.drawable(source.contracts.values()):
        numbers = source.vectors(contract.key)
        if numbers is None:
            drawn.warnings.append(f"{contract.key}: no curve, no value fits its contract")
            continue
        drawn.contracts.append(contract)
        drawn.entities += curves.send_curves(recording, contract, source.index(numbers.times_ns), numbers.values)
    joints = _draw_joints(recording, source, robot)
    drawn.groups = {
        name: limb
        for name, limb in source.groups(robot).items()
        if all(f"{JOINTS}/{joint}/measured" in joints for joint in limb)
    }
    drawn.entities += joints + _draw_latency(recording, source, robot)
    return drawn


def _draw_joints(recording: rr.RecordingStream, source: Source, robot: str) -> list[str]:
    """Send each joint as commanded and as measured, one above the other."""
    state = source.vectors(keys.robot_state(robot)) or source.vectors(keys.state_joints(robot))
    pair = {"commanded": source.vectors(keys.command_used(robot)), "measured": state}
    limbs = source.groups(robot).values()
    entities: list[str] = []
    for kind, numbers in pair.items():
        if numbers is None:
            return entities
        for index, name in enumerate(numbers.contract.names):
            if not name.endswith("_pos"):
                continue
            joint = name.removesuffix("_pos")
            entities.append(f"{JOINTS}/{joint}/{kind}")
            style = rr.SeriesLines(
                names=f"{joint} {kind} [rad]", colors=colour(joint, kind, limbs), widths=_WIDTHS[kind]
            )
            recording.log(entities[-1], style, static=True)
            columns = rr.Scalars.columns(scalars=numbers.values[:, index])
            recording.send_columns(entities[-1], source.index(numbers.times_ns), columns)
    return entities


def colour(joint: str, kind: str, limbs: Iterable[tuple[str, ...]]) -> tuple[int, int, int]:
    """Return the colour of a joint's curve: one hue per joint within its limb, paler for what was commanded."""
    limb = next((limb for limb in limbs if joint in limb), (joint,))
    parts = colorsys.hls_to_rgb(limb.index(joint) / len(limb), 0.75 if kind == "commanded" else 0.5, 0.8)
    red, green, blue = (round(255 * part) for part in parts)
    return red, green, blue


def _draw_latency(recording: rr.RecordingStream, source: Source, robot: str) -> list[str]:
    """Send the time between consecutive instants of each policy step, in milliseconds."""
    timing = source.vectors(keys.policy_timing(robot))
    if timing is None:
        return []
    instants = timing.values[:, _FIRST_STAGE:]
    known = (instants[:, 1:] > 0) & (instants[:, :-1] > 0)
    latency_ms = np.where(known, np.diff(instants, axis=1) * 1e-6, np.nan)
    names = [f"{start} to {end} [ms]" for start, end in pairwise(TIMING_STAGES)]
    entity = f"{curves.CURVES}/latency/{robot}"
    recording.log(entity, rr.SeriesLines(names=names), static=True)
    columns: Any = rr.Scalars.columns(scalars=latency_ms.ravel()).partition(np.full(len(latency_ms), len(names)))
    recording.send_columns(entity, source.index(timing.times_ns), columns)
    return [entity]
