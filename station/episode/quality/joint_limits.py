"""Where the joints of a robot end: by the command formats that are registered for it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from station import registry
from station.protocols import CommandFormat, Floats

_JOINT = "_pos"


class JointLimits(NamedTuple):
    """Ends of some joints, and what says so: arrays of shape (n,) [rad], nan for a joint that nothing is known of."""

    lower: Floats
    upper: Floats
    said_by: str


def limits(robot: str, joints: tuple[str, ...]) -> JointLimits | None:
    """Return the limits of joints of a robot; None where no format knows any of them.

    A format is registered (entry points ``station.commands``) with the robot that it is for, and its range of a joint
    is that of the robot: a G1's come from `adapters.robots.g1.joints`.
    """
    lower, upper = np.full(len(joints), np.nan), np.full(len(joints), np.nan)
    said_by = []
    for name in registry.names("command"):
        form: CommandFormat = registry.find("command", name)
        known = {element.name: i for i, element in enumerate(form.elements)} if form.robot == robot else {}
        places = [
            (column, known[f"{joint}{_JOINT}"]) for column, joint in enumerate(joints) if f"{joint}{_JOINT}" in known
        ]
        for column, index in places:
            lower[column], upper[column] = form.lower[index], form.upper[index]
        said_by += [name] if places else []
    return JointLimits(lower, upper, f"command format {', '.join(said_by)}") if said_by else None
