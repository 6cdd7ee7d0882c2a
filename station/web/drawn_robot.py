"""A robot as a page draws it: its shapes once, then where each body is, what was asked for, and its joints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.bus import codec, keys
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.contract import Contract
from station.view import poses
from station.view.find_model import find_model
from station.view.poses import Numbers, Posture
from station.web.feeds import Frame

if TYPE_CHECKING:
    from station.view.shapes import Shape

MOST_JOINTS = 400
"""That a page is told of."""

Latest = Callable[[str], Sample | None]


class Seen(NamedTuple):
    """A robot at an instant: where it was, where it was asked to be, None where nothing says; and its gate's state."""

    where: Posture | None
    asked: Posture | None
    gate: str


class DrawnRobot:
    """One robot.

    Args:
        name: Suffix of its keys.
        known: What its keys hold.
        servers: What the servers stated, the model among it.
        recorded: What keys of an episode held, by their own contracts, which count more than what is known.

    Attributes:
        keys: What has to be watched.
    """

    def __init__(
        self, name: str, known: Contracts, servers: Iterable[Mapping[str, Any]], recorded: Iterable[Contract] = ()
    ) -> None:
        self.name = name
        self._description = known.robot(name)
        self._contracts = {item.key: item for item in (*known.of(name), *recorded) if item.vector_codec}
        states = poses.state_keys(name, self._contracts.values(), self._description)
        commands = poses.command_keys(name, self._contracts.values(), self._description)
        self._states = [key for key in states if key in self._contracts]
        self._commands = [key for key in commands if key in self._contracts]
        self._gate = keys.command_gate(name)
        self.keys = frozenset((self._gate, *self._states, *self._commands))
        self._model, notes = find_model(list(servers), name)
        self._note = "; ".join(notes)
        self._joints = self._named_joints()
        self._last: tuple[Sample | None, ...] = ()

    @property
    def feed(self) -> str:
        """Name of its feed."""
        return f"robot:{self.name}"

    def scene(self) -> dict[str, Any]:
        """Return what a page needs once: bodies, shapes, joints."""
        model = self._model
        bodies = () if model is None else model.bodies
        index = {body: place for place, body in enumerate(bodies)}
        shapes = () if model is None else (shape for shape in model.shapes if shape.body in index)
        return {
            "robot": self.name, "bodies": bodies, "joints": self._joints, "unit": "rad", "note": self._note,
            "floats": model is not None and model.floats, "shapes": [_plain(shape, index) for shape in shapes],
        }  # fmt: skip

    def frame(self, latest: Latest, now_s: float) -> Frame | None:
        """Return its newest frame, where something is new; else None.

        Args:
            latest: Returns what a key holds.
            now_s: Now, on the monotonic clock [s].
        """
        samples = tuple(latest(key) for key in (self._gate, *self._states, *self._commands))
        if samples == self._last or not any(samples):
            return None
        self._last = samples

        facts, payload = self.drawn(self.seen(latest))
        arrived = [found.arrived_ns for key in self._states if (found := latest(key)) is not None and found.arrived_ns]
        return Frame({"f": self.feed, **facts}, payload, max(arrived) * 1e-9 if arrived else now_s)

    def seen(self, latest: Latest) -> Seen:
        """Return how it is, by what its keys hold."""

        def find(key: str) -> Numbers | None:
            return poses.newest(latest(key), self._contracts[key]) if key in self._contracts else None

        where = poses.measured(find, self._states, self._description)
        asked = None if where is None else poses.asked(find, self._commands, where)
        sample = latest(self._gate)
        gate = {} if sample is None else codec.parse_facts(sample.value)
        return Seen(where, asked, str(gate.get("state", ""))[:40])

    def drawn(self, seen: Seen) -> tuple[dict[str, Any], bytes]:
        """Return what a frame says, and its float32 numbers: poses of the bodies, measured and asked; then `joints`."""
        placed = self._placed(seen.where), self._placed(seen.asked)
        facts = {"gate": seen.gate, "has_pose": placed[0] is not None, "has_ghost": placed[1] is not None}
        parts = [part for part in (*placed, self.joints(seen)) if part is not None]
        return facts, packed(np.concatenate(parts))

    def joints(self, seen: Seen) -> NDArray[np.float64]:
        """Return the positions of the joints in the order of the page, measured, then asked; NaN where nothing says."""
        return np.concatenate([self._columns(seen.where), self._columns(seen.asked)])

    def _placed(self, where: Posture | None) -> NDArray[np.float64] | None:
        """Return position and quaternion of each body, one after the other; None where nothing says."""
        if self._model is None or where is None:
            return None
        positions, turns = self._model.poses(where.root, where.joints, where.q)
        found = np.concatenate([positions[0], turns[0]], axis=1).ravel()
        return found if np.isfinite(found).all() else None

    def _columns(self, where: Posture | None) -> NDArray[np.float64]:
        """Return the positions of the joints in the order of the page [rad]; NaN where nothing says."""
        known = {} if where is None else dict(zip(where.joints, where.q[0], strict=True))
        return np.array([known.get(joint, np.nan) for joint in self._joints], dtype=np.float64)

    def _named_joints(self) -> tuple[str, ...]:
        named = () if self._description is None else tuple(self._description.joint_names)
        told = (
            element.removesuffix("_pos")
            for key in self._states
            for element in self._contracts[key].names
            if element.endswith("_pos")
        )
        return (named or tuple(dict.fromkeys(told)))[:MOST_JOINTS]


def packed(numbers: NDArray[np.float64]) -> bytes:
    """Return numbers as a page reads them, float32; what is too large for that is infinite."""
    with np.errstate(over="ignore"):
        return numbers.astype("<f4").tobytes()


def _plain(shape: Shape, index: Mapping[str, int]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "body": index[shape.body], "kind": shape.kind, "rgba": shape.rgba.tolist(),
        **{name: _rounded(getattr(shape, field)) for name, field in _NUMBERS},
    }  # fmt: skip
    if shape.kind == "mesh":
        found |= {"vertices": _rounded(shape.vertices), "normals": _rounded(shape.normals),
                  "faces": shape.faces.ravel().tolist()}  # fmt: skip
    return found


_NUMBERS = (("pos", "pos"), ("quat", "quat_wxyz"), ("size", "size"))


def _rounded(values: NDArray[Any]) -> list[float]:
    return [round(float(value), 4) for value in values.ravel()]
