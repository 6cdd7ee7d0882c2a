"""Asking a robot's own controller for something: JSON on ``station:controller``, answered in its ``command_gate``."""

from __future__ import annotations

import getpass
from typing import Literal

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.life import arm_request, request
from station.life.request import LateS

Action = Literal["clear", "profile", "throttle", "release"]

WITHIN_S = 8.0
"""Longest wait for an answer [s]: clearing gives up after five."""


RELEASED_WITHIN_S = 15.0
"""Longest wait for a release [s]: a robot is asked again for ten seconds."""


class ControllerRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is asked for.

    Attributes:
        action: Of an arm: ``clear`` faults; choose a named ``profile``; send targets on every n-th tick only
            (``throttle``). Of a robot with a controller of its own: have that ``release`` the motors.
        id: Found again in the answer.
        robot: Suffix of the robot's keys.
        profile: Name, for ``profile``.
        throttle: Ticks, for ``throttle``.
        who: For the recording.
        late_s: How long after it was first written this was [s].
    """

    action: Action
    id: str = ""
    robot: str = ""
    profile: str = ""
    throttle: int = 0
    who: str = ""
    late_s: LateS = 0.0


class ControllerAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a request; `refused` says why nothing was done, or is ""."""

    id: str
    action: Action
    refused: str = ""


class _Gate(msgspec.Struct):
    controller: ControllerAnswer | None = None


def ask(
    bus: Bus, robot: str, action: Action, *, profile: str = "", throttle: int = 0, within_s: float = WITHIN_S
) -> None:
    """Ask and wait until it is done.

    Args:
        bus: The bus that the robot's server runs on.
        robot: Suffix of the robot's keys.
        action, profile, throttle: As in `ControllerRequest`.
        within_s: Longest wait [s].

    Raises:
        NotReady: no server drives that robot, the bus did not take the request, or no answer came.
        Refused: the controller's session said no; with its reason.
    """
    wanted = ControllerRequest(
        action=action, id=request.new_id(), robot=robot, profile=profile, throttle=throttle, who=getpass.getuser()
    )
    arm_request.server_of(bus, robot)
    request.ask_robot(
        bus, robot, keys.CONTROLLER, wanted, lambda data: _answer(data, wanted.id), what=action, within_s=within_s
    )


def _answer(data: bytes, asked: str) -> ControllerAnswer | None:
    """Return the answer to a request that an arm's gate tells of, if it does."""
    try:
        answer = codec.parse_struct(data, _Gate).controller
    except codec.BadValue:  # a foreign value; the server's next one is 4 ms away
        return None
    return answer if answer is not None and answer.id == asked else None
