"""Policy steps of a recording: what the policy saw, was asked and did, put together again from single keys.

A G1 server writes the state at the start of a tick and everything that the policy made of it in one later command.
The values of one command carry the same writer's time, which is what joins them; the state that a step saw is the
last one that the same process wrote before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from station.bus import codec, contracts, keys
from station.contract import TIMING_STAGES, Contract, Role
from station.episode.reading.reader import EpisodeReader, Message
from station.protocols import RobotState

Family = Callable[[str], str]

_LARGEST = 1 << 62  # of a time [ns], so that the difference of two fits 64 bits too

RESULTS: tuple[Family, ...] = (
    keys.policy_obs,
    keys.policy_action,
    keys.policy_timing,
    keys.command_gate,
    keys.command_used,
    keys.target,
)
_OF_STEPS: tuple[Family, ...] = (keys.policy_timing, keys.policy_obs, keys.policy_action)
_OF_PARTS: tuple[Family, ...] = (keys.command_timing, keys.command_gate, keys.command_used)
STATES: tuple[Family, ...] = (keys.robot_state, keys.root_velocity, keys.sim_qpos, keys.state_joints)


@dataclass(frozen=True, slots=True)
class Step:
    """One policy step as it was recorded.

    Attributes:
        source: The process that made it.
        number: Sequence number of its results; consecutive steps differ by one.
        state_number: Sequence number of the state that it saw, 0 where none was recorded; likewise.
        at_ns: When the results were written, on the episode's clock [ns since the epoch].
        values: Bytes of the results by key, and of the state before them.
        before: The newest of the context keys that were asked for, by key, of all writers.
    """

    source: str
    number: int
    state_number: int
    at_ns: int
    values: dict[str, bytes]
    before: dict[str, bytes]


def robots(topics: Iterable[str], families: Iterable[Family] = _OF_STEPS) -> list[str]:
    """Return the suffixes of the robots of which keys of some families are among the topics, sorted.

    Args:
        topics: Keys.
        families: Of keys; by default those that only policy steps have.
    """
    prefixes = [family("") for family in families]
    own = [topic for topic in topics if not keys.is_stamp(topic)]  # a stamp that was deleted is a topic too
    return sorted({topic.removeprefix(p) for topic in own for p in prefixes if topic.startswith(p)})


def robots_of(reader: EpisodeReader) -> list[str]:
    """Return the suffixes of the robots of an episode: those that a policy or an operator drove, then those of which
    a state or a command is there all the same (stock scripts)."""
    topics, known = set(reader.topics()), reader.known
    driven = robots(topics)
    others = [
        name
        for name in known.robots()
        if any(item.key in topics and item.role in ("state", "command") and item.key.endswith(f"_{name}")
               for item in known.of(name))
    ]  # fmt: skip
    return list(dict.fromkeys((*driven, *others)))


def keys_of_joints(reader: EpisodeReader, robot: str, role: Role, first: Iterable[Family]) -> list[str]:
    """Return the keys in an episode that tell where the joints of a robot are, or shall be, the best one first.

    Args:
        reader: The episode.
        robot: Suffix of its keys.
        role: ``state`` or ``command``.
        first: The station's own keys of that kind.
    """
    found = contracts.of_joints(robot, role, reader.recorded.values(), reader.known.robot(robot))
    own = [key for family in first if (key := family(robot)) in reader.recorded]
    return list(dict.fromkeys((*own, *found)))


def robot_of_step(key: str) -> str | None:
    """Return the suffix of the robot whose policy steps write a key; None for a key of no step."""
    return next((key.removeprefix(family("")) for family in RESULTS if key.startswith(family(""))), None)


def state_key(robot: str, topics: Iterable[str]) -> str:
    """Return the key of the state that the control steps of a robot read: its joints, where that is all there is."""
    known = set(topics)
    is_arm = keys.state_joints(robot) in known and keys.robot_state(robot) not in known
    return keys.state_joints(robot) if is_arm else keys.robot_state(robot)


class StepJoiner:
    """Puts steps together from messages in file order, one robot at a time.

    Args:
        robot: Suffix of the robot's keys.
        results: Families of the keys that make a step; one of them suffices.
        context: Further keys of which each step shall carry the newest value before it.
        parts: Names of the robot's parts that are commanded apart, whose keys belong to its steps.
    """

    def __init__(
        self,
        robot: str,
        results: Iterable[Family] = RESULTS,
        context: Iterable[str] = (),
        parts: Iterable[str] = (),
    ) -> None:
        self._results = {family(robot) for family in results} | {family(part) for part in parts for family in _OF_PARTS}
        self._states = {family(robot) for family in STATES}
        self._context = set(context)
        self._newest: dict[str, bytes] = {}
        self._state: dict[str, dict[str, bytes]] = {}
        self._state_number: dict[str, int] = {}
        self._open: dict[str, Step] = {}

    @property
    def topics(self) -> set[str]:
        """The keys that it wants to be fed."""
        return self._results | self._states | self._context

    def feed(self, message: Message) -> Step | None:
        """Add a message; return the step that it completes, if any."""
        if message.channel.is_deletion:
            return None
        topic, source = message.topic, message.channel.source
        if topic in self._context:
            self._newest[topic] = message.data
        if topic in self._states:
            self._state.setdefault(source, {})[topic] = message.data
            self._state_number[source] = message.sequence
        if topic not in self._results:
            return None
        step = self._open.get(source)
        if step is not None and step.at_ns == message.publish_ns:
            step.values[topic] = message.data
            return None
        values = {**self._state.get(source, {}), topic: message.data}
        state_number = self._state_number.get(source, 0)
        self._open[source] = Step(
            source, message.sequence, state_number, message.publish_ns, values, dict(self._newest)
        )
        return step

    def finish(self) -> list[Step]:
        """Return the last step of each source."""
        last, self._open = list(self._open.values()), {}
        return last


def iterate(
    reader: EpisodeReader, robot: str, *, results: Iterable[Family] = RESULTS, context: Iterable[str] = ()
) -> Iterator[Step]:
    """Iterate over the steps of a robot, in the order of the file, holding no more than one per source."""
    joiner = StepJoiner(robot, results, context)
    for message in reader.messages(joiner.topics):
        step = joiner.feed(message)
        if step is not None:
            yield step
    yield from joiner.finish()


def robot_state(contract: Contract | None, data: bytes) -> RobotState | None:
    """Return the state that bytes of `keys.robot_state` hold, or None when they do not fit its contract."""
    columns = _columns(contract.names) if contract is not None else {}
    if not columns or len(data) != 8 * sum(len(indices) for indices in columns.values()):
        return None
    values = codec.parse_f64(data)
    return RobotState(mono_ns=0, **{name: values[indices] for name, indices in columns.items()})


def timing_row(data: bytes | None) -> list[int] | None:
    """Return a row of `keys.policy_timing` (tick, command_seq, the stages [ns]), or None for what is none."""
    try:
        row = codec.parse_struct(data or b"", list[int])
    except codec.BadValue:
        return None
    if len(row) != 2 + len(TIMING_STAGES):
        return None
    return row if all(abs(number) < _LARGEST for number in row) else None


@cache
def _columns(names: tuple[str, ...]) -> dict[str, NDArray[np.int64]]:
    """Columns of `keys.robot_state` by the field of `RobotState` that they fill."""
    suits: dict[str, Callable[[str], bool]] = {
        "q": lambda name: name.endswith("_pos"),
        "dq": lambda name: name.endswith("_vel"),
        "quat_wxyz": lambda name: name.startswith("root_quat_"),
        "gyro": lambda name: name.startswith("gyro_"),
    }
    found = {
        name_of_field: np.array([index for index, name in enumerate(names) if fits(name)], dtype=np.int64)
        for name_of_field, fits in suits.items()
    }
    return found
