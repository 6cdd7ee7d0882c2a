"""The policy steps of an episode as arrays: what the policy saw, was asked, and did, one row per step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from station.api.frames import pandas_frame, polars_frame, unique_names
from station.api.table import Table
from station.bus import codec, keys
from station.bus.stamp import boot_of
from station.contract import TIMING_STAGES, Contract
from station.episode.reading import steps as recorded
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step
from station.episode.reading.vectors import decoder, fitting
from station.errors import EpisodeError, UnknownName
from station.printable import printable
from station.protocols import Floats

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

_PARTS = ("command", "state", "observation", "action", "target", "timing")
_COUNTERS = ("tick", "command_seq")
_NANOSECONDS = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class Steps:
    """The n policy steps of one robot in order: row k of every part belongs to step k.

    A part has no columns where the recording holds nothing of it, such as the observation of an arm without a policy.
    A row is NaN where its step holds no value of that part, or one that does not fit. Where policies took over from
    each other whose observations have different lengths, shorter ones have NaN behind their last number.

    Attributes:
        robot: The robot.
        time_s: When the results of each step were written, from the start of the episode, shape (n,) [s].
        number: The writer's number of each step, int64, shape (n,); consecutive steps of one process differ by one.
        gate: State of the gate in each step, such as ``tracking``, shape (n,); "" where none was recorded.
        policy: Name of the policy that drove in each step, shape (n,); "" where the robot has but one.
        command: The command that the policy got, after the gate.
        state: The newest state of the robot that its process had written before.
        observation: Input of the network.
        action: Raw output of the network.
        target: What was sent to the robot, after its limits.
        timing: Tick, number of the command, and the instants of the step [s] on the monotonic clock of the robot's
            machine, NaN where unknown: from the start of the episode where that machine recorded it, else only their
            differences have a meaning.
    """

    robot: str
    time_s: Floats
    number: Ints
    gate: NDArray[np.str_]
    policy: NDArray[np.str_]
    command: Table
    state: Table
    observation: Table
    action: Table
    target: Table
    timing: Table

    def __len__(self) -> int:
        return len(self.time_s)

    def pandas(self) -> pd.DataFrame:
        """Return a pandas frame: index ``time_s`` [s], ``number``, ``gate``, and columns such as ``action.0``.

        A column is called ``part.name``; ``frame.attrs["units"]`` holds the units by column.

        Raises:
            StationError: pandas is not installed.
        """
        units = {
            f"{part}.{name}": unit
            for part, table in self.parts().items()
            for name, unit in zip(table.names, table.units, strict=True)
        }
        return pandas_frame(self.time_s, self.columns(), units)

    def polars(self) -> pl.DataFrame:
        """Return a polars frame: column ``time_s`` [s], then columns as in `pandas`.

        Raises:
            StationError: polars is not installed.
        """
        return polars_frame(self.time_s, self.columns())

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return ``number``, ``gate``, ``policy``, and each column of each part as ``part.name``, shape (n,) each."""
        found = {
            f"{part}.{name}": column for part, table in self.parts().items() for name, column in table.columns().items()
        }
        return {"number": self.number, "gate": self.gate, "policy": self.policy, **found}

    def parts(self) -> dict[str, Table]:
        """Return the tables by name, `command` to `timing`."""
        return {part: getattr(self, part) for part in _PARTS}

    def __repr__(self) -> str:
        sizes = ", ".join(f"{part} ({len(table.names)})" for part, table in self.parts().items())
        return printable(f"{len(self)} policy steps of {self.robot}: {sizes}", 1000)


def read_steps(reader: EpisodeReader, robot: str | None) -> Steps:
    """Read the policy steps of a robot; None for the only one that has some.

    Raises:
        UnknownName: no such robot has policy steps, others have.
        EpisodeError: no robot has policy steps, or several have and none is named.
    """
    topics = reader.topics()
    known = recorded.robots(topics)
    if not known:
        raise EpisodeError(f"{reader.episode_id}: no policy steps in it")
    if robot is None and len(known) > 1:
        raise EpisodeError(f"{reader.episode_id}: policy steps of {' and '.join(known)}; name the robot")
    robot = known[0] if robot is None else robot
    if robot not in known:
        raise UnknownName("robot with policy steps", robot, known)
    steps = list(recorded.iterate(reader, robot))
    by_key = _Columns(reader, steps)
    gates = [codec.parse_facts(step.values.get(keys.command_gate(robot))) for step in steps]
    state = keys.robot_state(robot) if keys.robot_state(robot) in topics else keys.state_joints(robot)
    return Steps(
        robot=robot,
        time_s=by_key.time_s,
        number=np.array([step.number for step in steps], dtype=np.int64),
        gate=np.array([str(gate.get("state", "")) for gate in gates], dtype=np.str_),
        policy=np.array([str(gate.get("policy", "")) for gate in gates], dtype=np.str_),
        command=by_key.table(keys.command_used(robot)),
        state=by_key.table(state),
        observation=by_key.table(keys.policy_obs(robot)),
        action=by_key.table(keys.policy_action(robot)),
        target=by_key.table(keys.target(robot)),
        timing=by_key.timing(keys.policy_timing(robot)),
    )


class _Columns:
    """Makes a table of what the steps of an episode hold of a key."""

    def __init__(self, reader: EpisodeReader, steps: Sequence[Step]) -> None:
        self._steps = steps
        self._anchor = reader.anchor
        self._contracts: Mapping[str, Contract] = {
            channel.topic: channel.contract for channel in reader.channels() if channel.contract is not None
        }
        self.time_s: Floats = np.array([step.at_ns - reader.start_ns for step in steps]) * _NANOSECONDS

    def table(self, key: str) -> Table:
        values = [step.values.get(key) for step in self._steps]
        contract = self._contracts.get(key)
        if contract is None or contract.vector_codec is None:
            return self._table(key, [None] * len(values), (), (), len(values) - values.count(None))
        decode = decoder(contract.codec)
        has_names = bool(contract.elements)
        rows = fitting(contract, values) if has_names else [decode(each) if each else None for each in values]
        width = len(contract.elements) or max((len(row) for row in rows if row is not None), default=0)
        skipped = sum(row is None for row in rows) - values.count(None)
        return self._table(key, rows, *names_and_units(contract, width), skipped)

    def timing(self, key: str) -> Table:
        names = (*_COUNTERS, *TIMING_STAGES)
        units = ("",) * len(_COUNTERS) + ("s",) * len(TIMING_STAGES)
        rows = [self._timing(step, step.values.get(key)) for step in self._steps]
        missing = sum(key not in step.values for step in self._steps)
        if missing == len(rows):
            return self._table(key, rows, (), (), 0)
        return self._table(key, rows, names, units, rows.count(None) - missing)

    def _timing(self, step: Step, data: bytes | None) -> list[float] | None:
        row = recorded.timing_row(data)
        if row is None:
            return None
        zero_ns = self._anchor.mono_ns if self._anchor is not None and boot_of(step.source) == self._anchor.boot else 0
        counters, instants = row[: len(_COUNTERS)], row[len(_COUNTERS) :]
        return [*counters, *((at_ns - zero_ns) * _NANOSECONDS if at_ns else np.nan for at_ns in instants)]

    def _table(
        self, key: str, rows: Sequence[Any], names: tuple[str, ...], units: tuple[str, ...], skipped: int
    ) -> Table:
        values = np.full((len(rows), len(names)), np.nan)
        for index, row in enumerate(rows):
            if row is not None:
                values[index, : len(row)] = row
        return Table(key, self.time_s, self.time_s, values, names, units, skipped)


def names_and_units(contract: Contract, width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what the numbers of a key are called, numbers from "0" where its contract does not say, and their units.

    Args:
        contract: The contract.
        width: How many numbers its values have.
    """
    if not contract.elements:
        return tuple(str(index) for index in range(width)), ("",) * width
    return tuple(unique_names(contract.names)), tuple(element.unit for element in contract.elements)
