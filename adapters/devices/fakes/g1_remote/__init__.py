"""States of a G1 with no robot behind them: those of its remote that a script moves.

    {"device": "g1-remote", "steps": [
        {"at_s": 0.5, "held": ["L1"], "sticks": [0, 0.6, 0, 0]},     left x, left y, right x, right y, from now on
        {"at_s": 2.0, "is_on": false}, {"at_s": 3.0, "is_on": true}, {"at_s": 4.0, "held": []}]}

A robot twin has a remote as well (`station robot-twin g1 sticks=… remote=…`), and a network.
"""

from __future__ import annotations

import time
from pathlib import Path

from adapters.devices.fakes import script
from adapters.devices.fakes.script import Clock, Play, Script, Step
from adapters.robots.g1.dds import messages
from adapters.robots.g1.dds.buttons import BUTTONS
from adapters.robots.g1.dds.remote import Sticks, remote_bytes
from station.errors import did_you_mean


class RemoteStep(Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a remote may do.

    Attributes:
        held: Buttons that are down from now on.
        sticks: Where the sticks are from now on, -1 to 1: left x, left y, right x, right y.
        is_on: Whether it is on from now on.
    """

    held: tuple[str, ...] | None = None
    sticks: tuple[float, float, float, float] | None = None
    is_on: bool | None = None

    def __post_init__(self) -> None:
        for name in self.held or ():
            if name not in BUTTONS:
                raise ValueError(f"no button {name!r}{did_you_mean(name, BUTTONS)}")
        if not all(-1.0 <= value <= 1.0 for value in self.sticks or ()):
            raise ValueError(f"sticks are {list(self.sticks or ())}; expected -1 to 1 for each")


class FakeStates:
    """What a robot sends, as `adapters.robots.g1.dds.network.Reader` gives it: a state at each look.

    Args:
        steps: What the remote does.
        clock: Tells the time [s].
    """

    def __init__(self, steps: Script[RemoteStep], clock: Clock = time.monotonic) -> None:
        self._play = Play(steps, clock)
        self._held: tuple[str, ...] = ()
        self._sticks, self._is_on = Sticks(0.0, 0.0, 0.0, 0.0), True
        self._record = messages.new_state()

    def begin(self, start_s: float = 0.0) -> None:
        """Start the script's clock."""
        self._play.begin(start_s)

    def take(self) -> list[bytes]:
        """Return a state with what the remote shows now."""
        for _, step in self._play.due(self._play.time_s()) if self._play.has_begun else ():
            self._held = self._held if step.held is None else step.held
            self._sticks = self._sticks if step.sticks is None else Sticks(*step.sticks)
            self._is_on = self._is_on if step.is_on is None else step.is_on
        self._record["remote"] = remote_bytes(self._held, self._sticks) if self._is_on else 0
        return [messages.signed(self._record)]


def install(file: Path) -> FakeStates:
    """Return the states that a script makes.

    Raises:
        BadFile: the script cannot be read.
    """
    return FakeStates(script.load(file, "g1-remote", RemoteStep))
