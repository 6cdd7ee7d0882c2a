"""A walk whose commands end for good, in simulation: how far the robot goes on, and whether it falls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.bus import codec
from station.control.command_validator import CommandSample
from station.control.rig import Rig
from station.protocols import Motion, SimulatedRobot

ENTER_S, AFTER_S = 2.0, 5.0


@dataclass(frozen=True)
class Lost:
    """What came of it.

    Attributes:
        speed_mps: Commanded speed in the last command [m/s].
        farthest_m: Greatest distance of the root from where it was then, within five seconds [m].
        fell: Whether it fell.
    """

    speed_mps: float
    farthest_m: float
    fell: bool


def lose(rig: Rig, motion: Motion, at_s: float) -> Lost:
    """Enter a motion two seconds before an instant of it [s]; nothing is sent after that instant."""
    assert isinstance(rig.robot, SimulatedRobot)
    command_format, period_s = rig.command_format, rig.period_s
    rig.policy.reset()
    rig.robot.reset()
    control, sample, places, speed = rig.control(), None, [], 0.0
    enter_s = min(ENTER_S, at_s)
    for tick in range(round((enter_s + AFTER_S) / period_s)):
        now_s = tick * period_s
        if now_s <= enter_s:
            command = command_format.encode(motion.at(at_s - enter_s + now_s + period_s), motion.joint_names)
            sample, speed = CommandSample(codec.json_vector(command), arrived_s=now_s), float(np.hypot(*command[:2]))
            places.clear()
        record = control.step(control.sense(), sample, now_s)
        assert record.state.root_pos is not None
        places.append(record.state.root_pos[:2])
        if record.fall is not None:
            return Lost(speed, np.inf, fell=True)
    return Lost(speed, float(np.hypot(*(np.array(places) - places[0]).T).max()), fell=False)
