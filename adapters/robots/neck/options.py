"""Settings of a neck. Imports nothing heavy."""

from __future__ import annotations

import math

import msgspec


class NeckOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a neck of two servos, yaw and pitch.

    Attributes:
        port: Its serial port, best one of ``/dev/serial/by-id``.
        baud: Rate that the servos are set to [bit/s].
        ids: Numbers of the servos, yaw first.
        zero_ticks: What each shows where the robot looks straight ahead, 4096 to a turn.
        signs: 1 where a servo counts up as the robot looks to the right, or up, as TWIST2's commands do; else -1.
        most_rad: How far each may turn to either side, whatever is asked [rad].
        first_state_within_s: Longest wait until both servos have said where they are [s].
    """

    port: str
    baud: int = 2_000_000
    ids: tuple[int, int] = (0, 1)
    zero_ticks: tuple[int, int] = (2048, 2048)
    signs: tuple[int, int] = (1, 1)
    most_rad: tuple[float, float] = (1.4, 0.8)
    first_state_within_s: float = 5.0

    def __post_init__(self) -> None:
        if self.ids[0] == self.ids[1] or not all(0 <= id_ <= 252 for id_ in self.ids):
            raise ValueError(f"ids is {list(self.ids)}; expected two different numbers from 0 to 252")
        if not set(self.signs) <= {1, -1}:
            raise ValueError(f"signs is {list(self.signs)}; expected 1 or -1 for each")
        if not all(0.0 < most <= math.pi for most in self.most_rad):
            raise ValueError(f"most_rad is {list(self.most_rad)}; expected more than 0 and at most pi for each")
