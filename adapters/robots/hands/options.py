"""Settings of hands on a robot's DDS network. Imports nothing heavy."""

from __future__ import annotations

from typing import Literal

from adapters.robots.g1.dds.options import NetworkOptions

Fingers = Literal["as-twist2", "middle-index", "index-middle"]


class HandOptions(NetworkOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a hand, beside where it is on the network.

    Attributes:
        first_state_within_s: Longest wait for its first state [s].
    """

    first_state_within_s: float = 5.0


class Dex3Options(HandOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a Dex3-1.

    Attributes:
        motors: In which order its motors have the fingers after the thumb, which its sources contradict each other in:
            ``middle-index``, ``index-middle``, or ``as-twist2``: of the left hand the first, of the right the second.
            Move one finger at a time, and look.
    """

    motors: Fingers = "as-twist2"
