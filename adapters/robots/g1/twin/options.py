"""Settings of a G1's robot twin. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal

from adapters.robots.g1.dds.options import NetworkOptions
from adapters.robots.hands.options import Fingers
from adapters.robots.legged.unitree import G1


class G1TwinOptions(NetworkOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the twin, beside where it is on the network.

    Attributes:
        model: MJCF of the robot, a path or ``collection:path``.
        mode_machine: What kind of G1 it is, and says so: 5 with 29 joints, 6 with a locked waist, 4 with 23 joints.
        is_released: Whether its own controller has let go of the motors already; as it boots, it has not.
        hands: What it has for hands: ``none``, ``dex3``, ``inspire-dfx`` or ``inspire-dftp``.
        hand_motors: Order of the motors of a Dex3-1, as in the settings of its robot.
        neck: Folder in which the serial port of a neck's servos appears; "" for none.
        seed: Of offsets, noise and losses.
    """

    model: str = G1.mjcf
    mode_machine: Literal[4, 5, 6] = 5
    is_released: bool = False
    hands: Literal["none", "dex3", "inspire-dfx", "inspire-dftp"] = "none"
    hand_motors: Fingers = "as-twist2"
    neck: str = ""
    seed: int = 0
