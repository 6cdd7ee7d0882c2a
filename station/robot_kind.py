"""What a robot registers: its settings, how it is made, and what it says of itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from station import config as configs
from station.description import RobotDescription
from station.protocols import CommandFormat, Policy, Robot, RobotState


class RobotKind(msgspec.Struct, frozen=True, kw_only=True):
    """A robot whose joints a policy moves; registered under ``station.robots``, imports nothing heavy.

    Attributes:
        name: Registered name: ``g1-mujoco``.
        about: What it is, in a line.
        is_simulated: Whether it is armed from the start, and stood up again, without anybody beside it.
        options: Type of its settings. One that is called ``viewer`` opens a window.
        make: Returns the robot; takes its options and the control period [s].
        describe: Returns what it says of itself when it follows commands of a format.
        values: Returns what it publishes at the start of a tick beside the station's own keys, for stock programs; of
            the state, the policy and the robot's name.
        policy: Registered name of the policy that drives it where none is named; ``direct`` for a robot that takes
            positions of its joints.
        checkpoint: That policy's file for this robot; "" for the policy's own default.
        is_default: Whether it is taken where no robot is named; one of all is.
        robot_name: Suffix of its keys where its policy follows commands that are for any robot; "" for a robot that
            follows none of those. Commands for one robot have its name.
        library, extra: Distribution that it needs, and the extra of ours that brings it; "" for none.
    """

    name: str
    about: str
    is_simulated: bool
    options: type[msgspec.Struct]
    make: Callable[[Any, float], Robot]
    describe: Callable[[CommandFormat], RobotDescription]
    values: Callable[[RobotState, Policy, str], Mapping[str, bytes]] | None = None
    policy: str
    checkpoint: str = ""
    is_default: bool = False
    robot_name: str = ""
    library: str = ""
    extra: str = ""

    def typed(self, options: Mapping[str, Any]) -> Any:
        """Return settings as its type has them.

        Raises:
            ConfigError: one that it does not have, or of another type.
        """
        return configs.build(self.options, options, where=f"robot {self.name}")
