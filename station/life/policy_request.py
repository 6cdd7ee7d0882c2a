"""Asking for another policy: JSON on ``station:policy``, answered in the robot's ``command_gate``."""

from __future__ import annotations

import getpass

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.errors import NotReady, Refused
from station.life import arm_request, request
from station.life.request import LateS

WITHIN_S = 8.0
"""Longest wait for an answer [s], which comes when the policy drives alone: after 5.2 s at most."""


class PolicyRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is asked for.

    Attributes:
        policy: Name of the policy that shall drive.
        id: Found again in the answer.
        robot: Suffix of the robot's keys.
        who: For the recording.
        late_s: How long after it was first written this was [s].
    """

    policy: str
    id: str = ""
    robot: str = ""
    who: str = ""
    late_s: LateS = 0.0


class PolicyAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a request, once that is known; `refused` says why the policy does not drive, or is ""."""

    id: str
    policy: str
    refused: str = ""


class Policies(msgspec.Struct, frozen=True, kw_only=True):
    """The policies of a robot, by the suffix of its keys: which one drives, and the names of all that may."""

    robot: str
    driving: str
    names: tuple[str, ...]


class _Gate(msgspec.Struct):
    policy: str = ""
    switch: PolicyAnswer | None = None


class _Stated(msgspec.Struct):
    policies: dict[str, dict[str, object]] = {}
    policy: dict[str, object] = {}


def policies(bus: Bus, name: str = "") -> list[Policies]:
    """Return the policies of the robots on a bus that a policy drives.

    Args:
        bus: The bus that their servers run on.
        name: Of the one robot, or of its server; "" for all.

    Raises:
        NotReady: no such server runs, or it has not said what it runs yet.
    """
    found: list[Policies] = []
    for server, robot in arm_request.robots_of(bus, name).items():
        try:
            stated = codec.parse_struct(bus.get(keys.server_config(server)) or b"", _Stated)
        except codec.BadValue as error:
            raise NotReady(f"server {server!r} has not stated its policies yet ({error})") from None
        first = str(stated.policy.get("name", ""))
        gate = _gate(bus.get(keys.command_gate(robot)) or b"")
        driving = gate.policy if gate is not None and gate.policy else first
        if first:  # an arm behind a controller of its own has none
            found.append(Policies(robot=robot, driving=driving, names=tuple(stated.policies) or (first,)))
    return found


def ask(bus: Bus, policy: str, *, name: str = "", within_s: float = WITHIN_S) -> str:
    """Have another policy drive a robot, and wait until it does; return the suffix of that robot's keys.

    Args:
        bus: The bus that the robot's server runs on.
        policy: Name of the policy, as the settings of its server have it.
        name: Of the robot, or of its server; "" for the one that has several policies.
        within_s: Longest wait [s].

    Raises:
        NotReady: no such server runs, the bus did not take the request, or no answer came.
        Refused: the policy does not take over, with the reason; or no robot, or more than one, has several policies.
    """
    return _ask(bus, _of_several(bus, name).robot, policy, within_s)


def ask_next(bus: Bus, *, name: str = "", within_s: float = WITHIN_S) -> str:
    """As `ask`, for the policy that comes after the one that drives; return its name."""
    robot = _of_several(bus, name)
    following = robot.names[(robot.names.index(robot.driving) + 1) % len(robot.names)]
    _ask(bus, robot.robot, following, within_s)
    return following


def _of_several(bus: Bus, name: str) -> Policies:
    known = policies(bus, name)
    able = [each for each in known if len(each.names) > 1]
    if not able:
        said = "; ".join(f"{each.robot} has {each.driving}" for each in known) or "no robot here has a policy"
        raise Refused(f"no other policy can take over: {said}; name others in its server's settings, `policies`")
    if len(able) > 1:
        raise Refused(f"several robots have several policies: {', '.join(each.robot for each in able)}; name one")
    return able[0]


def _ask(bus: Bus, robot: str, policy: str, within_s: float) -> str:
    wanted = PolicyRequest(policy=policy, id=request.new_id(), robot=robot, who=getpass.getuser())
    request.ask_robot(
        bus, robot, keys.POLICY, wanted, lambda data: _answer(data, wanted.id), what="policy", within_s=within_s
    )
    return robot


def _answer(data: bytes, asked: str) -> PolicyAnswer | None:
    """Return the answer to a request that a robot's gate tells of, if it does."""
    gate = _gate(data)
    return gate.switch if gate is not None and gate.switch is not None and gate.switch.id == asked else None


def _gate(data: bytes) -> _Gate | None:
    try:
        return codec.parse_struct(data, _Gate)
    except codec.BadValue:
        return None
