"""Where a robot is on its network. Imports nothing heavy."""

from __future__ import annotations

import re
from typing import Annotated, Literal

import msgspec

from adapters.robots.g1.dds.buttons import BUTTONS

LOOPBACK = "lo"
ROBOT_DOMAIN = 0
"""A robot's; simulations use another."""

STATE_RATE_HZ = 490.0
"""States that a robot sends at least, of 500 [Hz]."""

_INTERFACE = re.compile(r"[A-Za-z0-9_.:@-]{1,15}")  # Linux has 15 letters at most


class NetworkOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a robot is.

    Attributes:
        interface: Network interface that its cable is plugged into: ``eno1``; ``lo`` for a robot twin on this machine.
        domain: DDS domain: 0 for a robot.
    """

    interface: str = LOOPBACK
    domain: int = ROBOT_DOMAIN

    def __post_init__(self) -> None:
        if _INTERFACE.fullmatch(self.interface) is None:
            raise ValueError(f"interface {self.interface!r}: expected the name of a network interface, as in `ip link`")
        if not 0 <= self.domain <= 230:
            raise ValueError(f"domain is {self.domain}; expected 0 to 230")


Action = Literal["arm", "policy", "disarm"]

_WAIST = (13, 14)
ABSENT = {3: _WAIST, 6: _WAIST, 1: (*_WAIST, 20, 21, 27, 28), 4: (*_WAIST, 20, 21, 27, 28)}
"""Motors that a robot does not have, of 29, by what it says it is (``mode_machine``): roll and pitch of a locked waist;
of one with 23 joints pitch and yaw of the wrists too."""


class G1DdsOptions(NetworkOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a real G1, beside where it is on the network.

    Attributes:
        mode_machine: What the robot says it is when it is of the kind that the policy was made for, or is known to walk
            on: 5 for 29 joints, 6 for a locked waist, 4 for 23 joints. Joints that are not there are told as 0.
        first_state_within_s: Longest wait for its first state [s].
        least_state_rate_hz: States that have to come, of 500, before it is armed [Hz]. Of a robot 490; its twin on a
            busy machine sends fewer.
        guard, guard_port: Address of the guard (`bridges/g1_guard`) that owns the motors; "" for none: then nothing
            damps the robot when this process dies.
        remote: What buttons of the remote ask for: ``arm``, ``policy`` (the next one), ``disarm``. Select, and L2 with
            B, stop the robot whatever is set here.
    """

    mode_machine: Literal[4, 5, 6] = 5
    first_state_within_s: float = 5.0
    least_state_rate_hz: Annotated[float, msgspec.Meta(ge=450.0, le=500.0)] = STATE_RATE_HZ
    guard: str = ""
    guard_port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 47029
    remote: dict[str, Action] = {}

    def __post_init__(self) -> None:
        super().__post_init__()
        for button in self.remote:
            if button not in BUTTONS:
                raise ValueError(f"remote: {button!r} is none of {', '.join(BUTTONS)}")
