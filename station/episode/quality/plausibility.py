"""Whether what a robot's states and commands say can be so: by each other, by names and units, and by the steps' times.

Everything follows from what was recorded: the contracts of the keys, the robot's own description for the ends of its
joints, and the policy steps. Each question has its module: `values`, `derivatives`, `frozen`, `joint_order` and
`step_times`.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from station.bus import keys
from station.contract import Contract
from station.control.gate import MOVING
from station.description import stated
from station.episode.quality.blocks import SIZE, Block, Take, decoded
from station.episode.quality.derivatives import DerivativeMeter
from station.episode.quality.finding_parts import ContractDifference, Plausibility
from station.episode.quality.frozen import FrozenMeter, StepRows, StuckMeter
from station.episode.quality.joint_order import JointOrderMeter
from station.episode.quality.motion import ends_of
from station.episode.quality.step_times import StepTimesMeter, Timed
from station.episode.quality.values import ValueMeter
from station.episode.reading import steps
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step
from station.protocols import Floats

_TRACKING = "tracking"
_POSITION, _VELOCITY = "_pos", "_vel"
Feed = Callable[[Message], None]

_OPEN = 64  # steps of which results are awaited


def meters(reader: EpisodeReader, driven: list[str], *, is_lock_step: bool) -> dict[str, PlausibilityMeter]:
    """Return a meter for each robot of an episode; `driven` are those that have policy steps."""
    robots = dict.fromkeys([*driven, *steps.robots_of(reader)])
    return {robot: PlausibilityMeter(reader, robot, is_lock_step=is_lock_step) for robot in robots}


def differences(reader: EpisodeReader) -> list[ContractDifference]:
    """Return where a contract that was recorded with a key is not what the robot's own server states of it."""
    found = []
    for facts in reader.manifest.servers.values():
        for said in described.contracts() if (described := stated(facts)) is not None else ():
            recorded = reader.recorded.get(said.key)
            if recorded is None or reader.known.get(said.key) != said or recorded.elements == said.elements:
                continue
            pairs = zip(recorded.elements, said.elements, strict=False)
            place = next((index for index, (a, b) in enumerate(pairs) if a != b), None)
            names = [
                f"{len(items)} elements" if place is None else items[place].title
                for items in (recorded.elements, said.elements)
            ]
            found.append(ContractDifference(said.key, place or 0, *names))
    return found


class PlausibilityMeter:
    """Takes the blocks, the messages and the policy steps of one robot, and tells at the end what cannot be.

    Args:
        reader: The episode.
        robot: Suffix of its keys.
        is_lock_step: Whether states came as a machine had time for them.
    """

    def __init__(self, reader: EpisodeReader, robot: str, *, is_lock_step: bool) -> None:
        self._robot, self._start_ns = robot, reader.start_ns
        self._state_key = steps.state_key(robot, reader.topics())
        self._used_key, self._timing_key = keys.command_used(robot), keys.policy_timing(robot)
        description = reader.known.robot(robot)
        judged = {key: item for key, item in reader.recorded.items() if item is not None and self._is_judged(item)}
        self._values = {key: ValueMeter(self._start_ns, description) for key in judged}
        self._state, self._used = reader.contract(self._state_key), reader.contract(self._used_key)
        self._derivatives = self._derivative_meter(is_lock_step=is_lock_step)
        self._joints, self._columns = _shared(self._state, self._used)
        self._speeds = _columns(self._state, _VELOCITY, "rad/s")
        self._is_carried = description is not None and description.is_carried
        self._frozen = FrozenMeter(self._start_ns)
        self._stuck = StuckMeter(self._start_ns, self._joints, ends_of(description, self._joints))
        self._order = JointOrderMeter(self._joints)
        command = next(
            (item for item in judged.values() if item.role == "command" and _is_same(item, self._used)), None
        )
        self._command_key = command.key if command is not None else ""
        self._times = StepTimesMeter(self._used, command, self._start_ns)
        self._written: dict[str, tuple[int, int]] = defaultdict(lambda: (0, 0))  # by source: how many states, and when
        self._seen: OrderedDict[tuple[str, int], tuple[int, int]] = OrderedDict()  # by source and time of the results
        self._last_write = 0
        self._held: list[tuple[Timed, int, bytes, bytes, bool, NDArray[np.bool_] | None]] = []

    def takes(self) -> dict[str, Take]:
        """Return what takes the blocks of each key that is wanted."""
        found: dict[str, Take] = {key: meter.take for key, meter in self._values.items()}
        if self._state_key in found:
            found[self._state_key] = self._add_state
        return found

    def feeds(self) -> dict[str, Feed]:
        """Return what takes the messages of each key of which the time counts."""
        found = {
            self._state_key: self._add_write,
            self._timing_key: self._add_timing,
            self._command_key: self._add_command,
        }
        return {key: feed for key, feed in found.items() if key}

    def feed_step(self, step: Step, gate: str, heard: NDArray[np.bool_] | None = None) -> None:
        """Add a policy step, the gate's state, and what the policy listens to, shape (m,); None for all."""
        count, state_ns = self._seen.pop((step.source, step.at_ns), (0, 0))
        is_reused = 0 < count == self._last_write and self._state_key == keys.robot_state(self._robot)
        self._last_write = count
        used = step.values.get(self._used_key)
        timing = step.values.get(self._timing_key)
        timed = Timed(step.at_ns, timing, used if gate == _TRACKING else None, state_ns, is_reused)
        self._held.append((timed, count, step.values.get(self._state_key, b""), used or b"", gate in MOVING, heard))
        if len(self._held) >= SIZE:
            self._flush_steps()

    def result(self) -> Plausibility:
        """Return what cannot be, and how far what can be compared agrees."""
        self._flush_steps()
        agreement, like, factor = self._derivatives.velocities()
        orientation, gyro_factor = self._derivatives.orientation()
        with np.errstate(all="ignore"):
            stuck = self._stuck.result()
        return Plausibility(
            robot=self._robot,
            state_key=self._state_key if self._state_key in self._values else "",
            values=[found for meter in self._values.values() if (found := meter.result()) is not None],
            frozen=self._frozen.result(),
            stuck=stuck,
            repeats=self._frozen.repeats(),
            moving=self._frozen.moving,
            orientation_agreement=orientation,
            gyro_factor=gyro_factor,
            velocity_agreement=agreement,
            velocity_like=like,
            velocity_factor=factor,
            jumps=self._derivatives.jumps(),
            misplaced=self._order.misplaced(),
            reversed=self._order.reversed(),
            offsets_rad=self._order.offsets_rad(),
            times=self._times.result(),
        )

    def _derivative_meter(self, *, is_lock_step: bool) -> DerivativeMeter:
        names = self._state.names if self._state is not None else ()
        hz = self._state.rate_hz if self._state is not None and is_lock_step else None
        return DerivativeMeter(names, self._start_ns, 1.0 / hz if hz else None)

    def _add_write(self, message: Message) -> None:
        if not message.channel.is_deletion:
            source = message.channel.source
            self._written[source] = self._written[source][0] + 1, message.publish_ns

    def _add_timing(self, message: Message) -> None:
        source = message.channel.source
        self._seen[source, message.publish_ns] = self._written[source]
        if len(self._seen) > _OPEN:
            self._seen.popitem(last=False)

    def _add_command(self, message: Message) -> None:
        if message.channel.is_native and not message.channel.is_deletion:
            self._times.add_command(message.channel.source, message.sequence, message.publish_ns, message.data)

    def _is_judged(self, contract: Contract) -> bool:
        is_ours = contract.role in ("state", "command") and contract.key.endswith(f"_{self._robot}")
        return (is_ours or contract.key == self._used_key) and contract.vector_codec is not None

    def _add_state(self, block: Block) -> None:
        self._values[self._state_key].take(block)
        self._derivatives.take(block)

    def _flush_steps(self) -> None:
        held, self._held = self._held, []
        if not held:
            return
        self._times.take([timed for timed, *_ in held])
        if self._state is None or not self._state.elements:
            return
        states, fits = decoded(self._state, [state for _, _, state, *_ in held])
        whole = [one for one, fit in zip(held, fits.tolist(), strict=True) if fit]
        if not whole:
            return
        asked = self._asked([(used if moves else b"", heard) for *_, used, moves, heard in whole])
        q = states[:, self._columns[0]]
        with np.errstate(all="ignore"):  # a damaged recording holds any number
            speeds = np.nan_to_num(np.abs(states[:, self._speeds]).max(axis=1, initial=0.0))
        moving = np.array([moves for *_, moves, _ in whole], dtype=np.bool_)
        judged = np.full_like(asked, np.nan) if self._is_carried else asked  # what a hand holds stops its joints
        rows = StepRows(
            times=np.array([timed.at_ns for timed, *_ in whole], dtype=np.int64),
            writes=np.array([count for _, count, *_ in whole], dtype=np.int64),
            state=states,
            q=q,
            asked=judged,
            speed=np.where(moving, speeds, 0.0),
        )
        with np.errstate(all="ignore"):
            self._frozen.take(rows)
            self._stuck.take(rows)
            self._order.take(q, asked)

    def _asked(self, used: list[tuple[bytes, NDArray[np.bool_] | None]]) -> Floats:
        """Return the commanded positions of the shared joints; NaN where there is no command that the policy hears."""
        found = np.full((len(used), len(self._joints)), np.nan)
        if self._used is not None and self._joints:
            values, fits = decoded(self._used, [data for data, _ in used])
            found[fits] = values[:, self._columns[1]]
        for row, (_, heard) in zip(found, used, strict=True):
            if heard is not None:
                row[~heard[self._columns[1]]] = np.nan
        return found


def _shared(state: Contract | None, used: Contract | None) -> tuple[list[str], tuple[list[int], list[int]]]:
    """Return the joints whose positions both hold, and their columns in either."""
    if state is None or used is None:
        return [], ([], [])
    names = [state.names[column] for column in _columns(state, _POSITION, "rad") if state.names[column] in used.names]
    columns = [state.names.index(name) for name in names], [used.names.index(name) for name in names]
    return [name.removesuffix(_POSITION) for name in names], columns


def _columns(contract: Contract | None, ending: str, unit: str) -> list[int]:
    items = contract.elements if contract is not None else ()
    return [column for column, item in enumerate(items) if item.name.endswith(ending) and item.unit == unit]


def _is_same(command: Contract, used: Contract | None) -> bool:
    return used is not None and command.key != used.key and command.names == used.names
