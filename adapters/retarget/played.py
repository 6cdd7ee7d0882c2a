"""A person's motion as a motion of the robot: retargeted as it would be live, frame after frame."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace
from typing import Any

import numpy as np

from adapters.retarget.calibration import Calibration, from_height, of_person
from adapters.retarget.human import G1_SIZED, of_height
from adapters.retarget.pipeline import BodyRetarget
from adapters.retarget.skeleton import skeletons
from adapters.retarget.skeleton_file import Skeletons
from station.errors import UsageError
from station.protocols import Motion, Reference

RATE_HZ = 90.0
"""Of a headset that tracks a body."""

SHORTEST_M, TALLEST_M = 1.2, 2.2


class RetargetedMotion:
    """What retargeting made of a person's motion (`station.protocols.Motion`); nothing in it looks ahead.

    Args:
        person: The motion.
        calibration: Of that person; that of an average one of the height in the file when None.
        name: Short name.
        retarget: Layers in place of the default ones; fresh.
        facts: What a manifest says of where the person's motion is from.

    Raises:
        UsageError: neither a calibration nor a height.
        BodyLost: a frame that no body can be.
    """

    joint_names = BodyRetarget.joint_names
    """The 29 joints of the G1."""

    def __init__(
        self,
        person: Skeletons,
        *,
        calibration: Calibration | None = None,
        name: str = "skeleton",
        retarget: BodyRetarget | None = None,
        facts: dict[str, Any] | None = None,
    ) -> None:
        if calibration is None and person.height_m is None:
            raise UsageError(f"{name}: does not say how tall the person is; give a calibration, or add height_m")
        known = calibration or from_height(person.height_m or 0.0)
        steps = retarget or BodyRetarget(known)
        self._name, self._height_m, self._facts = name, known.height_m, dict(facts or {})
        self.references = [steps.step(person.body(index), person.capture_ns(index)) for index in range(len(person))]
        """One for each frame of the person."""
        self._times = (person.times_s - person.times_s[0]).tolist()

    @property
    def name(self) -> str:
        """Short name."""
        return self._name

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last [s]."""
        return float(self._times[-1])

    @property
    def fps(self) -> float:
        """Mean rate of the person's frames [Hz]."""
        return (len(self._times) - 1) / self.duration_s

    def at(self, time_s: float) -> Reference:
        """Return the newest reference at a time [s]: as a live stream is seen, without a frame that has not come."""
        return self.references[max(bisect_right(self._times, time_s + 1e-9) - 1, 0)]

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this motion."""
        told = {"fps": self.fps, "duration_s": self.duration_s, "person_m": self._height_m}
        return {"format": "skeleton", **self._facts, **told}


def person_of(motion: Motion, height_m: float | None = None, *, rate_hz: float = RATE_HZ) -> Skeletons:
    """Return the body of an operator who does a motion of the G1; of the robot's own size where no height is given.

    Raises:
        UsageError: a height that no person has.
    """
    if height_m is not None and not SHORTEST_M <= height_m <= TALLEST_M:
        raise UsageError(f"{motion.name}: a person of {height_m} m; expected {SHORTEST_M} to {TALLEST_M} m")
    lengths = G1_SIZED if height_m is None else of_height(height_m)
    times = np.arange(0.0, motion.duration_s + 1e-9, 1.0 / rate_hz)
    references = [motion.at(time_s) for time_s in times.tolist()]
    positions, quats = skeletons(
        np.array([reference.root_pos for reference in references]),
        np.array([reference.root_quat_wxyz for reference in references]),
        np.array([reference.q for reference in references]),
        lengths,
    )
    return Skeletons(positions, quats, times, lengths.height)


def imitated(motion: Motion, height_m: float, *, rate_hz: float = RATE_HZ) -> RetargetedMotion:
    """Return what a person of a height makes of a motion of the G1, by way of tracking and retargeting.

    Raises:
        UsageError: a height that no person has.
        StationError: the extra ``retarget`` is not installed.
    """
    person = person_of(motion, height_m, rate_hz=rate_hz)
    name = f"{motion.name}#retarget={height_m:g}"
    return RetargetedMotion(person, calibration=of_person(of_height(height_m)), name=name, facts=motion.facts())


def noisy(person: Skeletons, *, metres: float, radians: float, seed: int = 0) -> Skeletons:
    """Return the motion as a bad tracker would see it: white noise on every joint of every frame."""
    from station import rotations

    random = np.random.default_rng(seed)
    shaken = rotations.from_rotation_vector(random.normal(scale=radians, size=person.positions.shape))
    return replace(
        person,
        positions=person.positions + random.normal(scale=metres, size=person.positions.shape),
        quats_wxyz=rotations.normalized(rotations.multiply(shaken, person.quats_wxyz)),
    )
