"""The step `measure` of a runbook, as it is written there: what a stream of the bus is to say for a while."""

from __future__ import annotations

from typing import Literal

import msgspec

from station.errors import did_you_mean
from station.supervision.figures import Bounds

RATE = "rate"
"""In `expect`: rows that a stream has in a second."""

LED, AFTER = "led", "after"
"""In `expect`: how many joints were led, with `follows`; after how long motors let go [s], with `after_commands`."""


class AfterCommands(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What tells how motors are when nobody commands them, by names in which ``*`` stands for anything.

    Attributes:
        torque: Torques [N m].
        speed: Speeds of the same joints, in the same order [rad/s].
        bits: Words whose bits tell an error; "" for none.
        since: Event from which on there are no commands, where one comes; else that is so from the beginning.
    """

    torque: str
    speed: str
    bits: str = ""
    since: str = ""


class Measure(msgspec.Struct, frozen=True, kw_only=True):
    """What is measured, and what is expected of it.

    Attributes:
        measure: What it is for, in a sentence.
        stream: A key, or what it is without the name of its robot: ``state_samples``.
        for_s: For how long [s].
        expect: Bounds by the name of a number of the stream, in which ``*`` stands for anything; ``rate`` is how many
            rows it has in a second [Hz]; ``led`` and ``after`` as below.
        follows: A stream of targets, whose numbers are called as those of `stream` are: each joint that is led has to
            follow, and alone; ``led`` is how many were.
        after_commands: Tells whether motors hold, damp or are limp once they get no commands; ``after`` is when.
        if_not: What becomes of the runbook where something is not as expected.
    """

    measure: str
    stream: str
    for_s: float
    expect: dict[str, Bounds] = {}
    follows: str = ""
    after_commands: AfterCommands | None = None
    if_not: Literal["stop", "continue"] = "stop"

    def __post_init__(self) -> None:
        if not self.for_s > 0.0:
            raise ValueError(f"for is {self.for_s:g} s; expected more than 0")
        if self.follows and self.after_commands is not None:
            raise ValueError("follows and after_commands: expected one of them; give the other a step of its own")
        other = LED if self.follows else AFTER if self.after_commands is not None else ""
        for name in self.expect:
            if other and name not in (RATE, other):
                raise ValueError(
                    f"expect: {name!r} is no figure here{did_you_mean(name, (RATE, other))}; known: {RATE}, {other}"
                )

    def __str__(self) -> str:
        return f"measure: {self.measure}"
