"""The dead-man: whether an operator's movements drive the robot, and from where they are counted.

One machine for every device and every kind of input: poses, hands, leader joints, twists. It drives only after an edge
of the button that it has seen itself, with good data, and takes a picture of both sides at that moment; all that the
robot is asked afterwards is a difference from it, so the first command after engaging is the one before it, and
engaging anew never jumps. Whatever ends driving (letting go, silence, a jump, the bus, a stop) needs a new edge.

Pure: no device, no robot, no clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

Input = TypeVar("Input")
Target = TypeVar("Target")

State = Literal["released", "engaged", "spent"]
"""``spent``: the button is held but drives nothing until it is released and pressed again."""

Name = Literal["operator-engaged", "operator-disengaged", "operator-refused"]


@dataclass(frozen=True, slots=True)
class Change:
    """Something to tell the operator, and an event.

    Attributes:
        name: Of the event.
        reason: Why; short enough to be spoken.
    """

    name: Name
    reason: str


@dataclass(frozen=True, slots=True)
class Snapshot(Generic[Input, Target]):
    """Both sides at the moment of engaging.

    Attributes:
        start: What the operator's side was.
        target: What the robot was asked for then.
    """

    start: Input
    target: Target


class DeadMan(Generic[Input, Target]):
    """The state machine; `step` it once per tick.

    Two buttons can engage, whichever is pressed: one drives while it is held, the other turns driving on and off.

    Args:
        jump: Says what jumped between two inputs, or "".

    Attributes:
        state: See `State`.
        snapshot: While engaged, both sides at the moment of engaging; else None.
        reason: Why nothing is driven; "" while engaged and before the first press.
    """

    def __init__(self, jump: Callable[[Input, Input], str] = lambda before, now: "") -> None:
        self.state: State = "released"
        self.snapshot: Snapshot[Input, Target] | None = None
        self.reason = ""
        self._jump = jump
        self._was_held = True  # what was held before we looked is no edge
        self._is_kept = False  # engaged by the button that turns on and off
        self._before: Input | None = None

    @property
    def is_engaged(self) -> bool:
        """Whether the operator's movements drive the robot."""
        return self.state == "engaged"

    def step(
        self,
        held: bool | None,
        now: Input | None,
        target: Target,
        *,
        toggled: bool = False,
        why_blocked: str = "",
        why_not_engage: str = "",
    ) -> Change | None:
        """Update from both sides.

        Args:
            held: Whether the button that must be held is down; None when that is not known, which ends driving.
            now: The operator's side; None when it is not usable.
            target: What the robot is asked for at present: the robot's side, should this tick engage.
            toggled: Whether the button that turns driving on and off was pressed since the last tick.
            why_blocked: Why driving is not allowed now (a stop, a lost bus, stale data), or "".
            why_not_engage: Why driving may not begin now, though it may go on (a leader far from its follower), or "".

        Returns:
            What changed, if anything did.
        """
        why_blocked = why_blocked or ("no valid data from the device" if now is None or held is None else "")
        pressed = toggled or (held is True and not self._was_held)
        self._was_held = held is not False  # not known: it has to be seen released first
        jumped = self._jump(self._before, now) if now is not None and self._before is not None else ""
        self._before = now
        if self.state == "engaged":
            let_go = toggled if self._is_kept else held is False
            return self._disengage(why_blocked or jumped or ("released" if let_go else ""), held)
        if pressed:
            return self._engage(now, target, why_blocked or why_not_engage, is_kept=toggled)
        if held is False:
            self.state = "released"
        return None

    def disengage(self, reason: str) -> Change | None:
        """Stop driving now, whatever is held; return the change if there was one."""
        return self._disengage(reason, held=None) if self.state == "engaged" else None

    def _disengage(self, reason: str, held: bool | None) -> Change | None:
        if not reason:
            return None
        self.state = "released" if held is False else "spent"
        self.snapshot, self.reason = None, reason
        return Change("operator-disengaged", reason)

    def _engage(self, now: Input | None, target: Target, refusal: str, *, is_kept: bool) -> Change:
        if now is None or refusal:
            self.state, self.reason = "spent", refusal
            return Change("operator-refused", refusal)
        self.state, self.reason, self._is_kept = "engaged", "", is_kept
        self.snapshot = Snapshot(now, target)
        return Change("operator-engaged", "")
