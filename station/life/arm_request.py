"""Asking for a robot to be armed or disarmed: JSON on ``station:arm``, answered in each robot's ``command_gate``."""

from __future__ import annotations

import getpass
from typing import Any, Literal

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.watch import Watch
from station.errors import NotReady, Refused
from station.life import request
from station.life.request import LateS
from station.life.server import Health, read_health

Action = Literal["arm", "disarm"]

WITHIN_S = 10.0
"""Longest wait for a robot to be armed [s]: its ramp, and a low-level loop that is late."""


class ArmRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is asked for.

    Attributes:
        action: What to do.
        id: Found again in the answer.
        server: Name of the low-level server; "" for every one.
        who, reason: For the recording.
        late_s: How long after it was first written this was [s].
    """

    action: Action
    id: str = ""
    server: str = ""
    who: str = ""
    reason: str = ""
    late_s: LateS = 0.0


class ArmAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a request.

    Attributes:
        id: Of the request.
        action: What was asked for.
        refused: Why nothing was done, or "".
        began: Whether arming began by it; a robot that is armed already has nothing to do.
    """

    id: str
    action: Action
    refused: str = ""
    began: bool = False


class _Gate(msgspec.Struct):
    state: str = ""
    arming: str = ""
    arm: ArmAnswer | None = None


class _Stated(msgspec.Struct):
    robot: str
    parts: list[str] = []  # names of its parts' keys, where they are commanded apart


def ask(
    bus: Bus, action: Action, *, name: str = "", reason: str = "", within_s: float = WITHIN_S
) -> dict[str, list[str]]:
    """Arm or disarm and wait until it is done; return the states that each server went through, by name.

    Args:
        bus: The bus that the low-level servers run on.
        action: What to do.
        name: Of the low-level server, or of the robot that it drives; "" for every one that runs.
        reason: Why, for the recording.
        within_s: Longest wait [s].

    Raises:
        NotReady: no such server runs, the bus did not take the request, or a server did not answer.
        Refused: a server said no; with its reason.
    """
    robots = robots_of(bus, name)
    server = next(iter(robots)) if name else ""
    wanted = ArmRequest(action=action, id=request.new_id(), server=server, who=getpass.getuser(), reason=reason)
    deadline_s = bus.clock.monotonic_s() + within_s
    gates = {each: keys.command_gate(robot) for each, robot in robots.items()}
    with bus.watch(list(gates.values())) as watch:
        answers = dict.fromkeys(gates.values(), lambda data: _answer(data, wanted.id))
        request.ask(bus, watch, keys.ARM, wanted, answers, what=action, within_s=within_s)
        return {each: _follow(watch, each, gate, wanted, deadline_s) for each, gate in gates.items()}


def robots_of(bus: Bus, name: str = "") -> dict[str, str]:
    """Return the suffixes of the robots that low-level servers drive, by the servers' names.

    Args:
        bus: The bus that they run on.
        name: Of the one server, or of the robot that it drives; "" for all.

    Raises:
        NotReady: none of that name runs, or it has not said so yet.
    """
    return {health.name: robot_of(bus, health.name) for health in _low_level(bus, name)}


def server_of(bus: Bus, robot: str) -> str:
    """Return the name of the low-level server that drives a robot, given by its keys' suffix.

    Raises:
        NotReady: none does.
    """
    found = _low_level(bus, "")
    for health in found:
        if _drives(bus, health, robot):
            return health.name
    driven = sorted(robot_of(bus, health.name) for health in found)
    raise NotReady(f"no server drives {robot} on {bus.address}; those that run drive {', '.join(driven)}")


def story(action: Action, states: list[str]) -> str:
    """Return in words what a server went through."""
    if action == "disarm":
        return "disarmed: its policy runs, nothing is sent to the robot"
    return "armed, at full stiffness" if "arming" in states else "armed already"


def _low_level(bus: Bus, name: str) -> list[Health]:
    """Return the low-level servers that live: the one of that name, else the one that drives that robot; all for ""."""
    now_ns = bus.clock.wall_ns()
    found = [health for health in read_health(bus) if health.role == "low-level" and health.is_alive_at(now_ns)]
    chosen = [health for health in found if name in ("", health.name)]
    chosen = chosen or [health for health in found if _drives(bus, health, name)][:1]
    if not chosen:
        others = f" (there are: {', '.join(health.name for health in found)})" if found else ""
        raise NotReady(
            f"no low-level server {name + ' ' if name else ''}runs on {bus.address}{others}; start a station first"
        )
    return chosen


def _drives(bus: Bus, health: Health, robot: str) -> bool:
    try:
        stated = _stated(bus, health.name)
    except NotReady:  # it has not said so yet
        return False
    return robot == stated.robot or robot in stated.parts


def robot_of(bus: Bus, server: str) -> str:
    """Return the suffix of the robot that a low-level server drives, given by its name.

    Raises:
        NotReady: it has not said so yet.
    """
    return _stated(bus, server).robot


def _stated(bus: Bus, server: str) -> _Stated:
    try:
        return codec.parse_struct(bus.get(keys.server_config(server)) or b"", _Stated)
    except codec.BadValue as error:
        raise NotReady(f"server {server!r} has not stated which robot it drives yet ({error})") from None


def _follow(watch: Watch, name: str, key: str, wanted: ArmRequest, deadline_s: float) -> list[str]:
    """Wait until a server has done what was asked for."""
    seen: list[str] = []
    newest: Any = None
    while (left_s := deadline_s - watch.clock.monotonic_s()) > 0:
        newest = watch.wait(key, after=newest, timeout_s=left_s) or newest
        gate = _gate(newest.value) if newest is not None else None
        if gate is None or gate.arm is None or gate.arm.id != wanted.id:
            continue
        if gate.arm.refused:
            raise Refused(f"{name} is not {wanted.action}ed: {gate.arm.refused}")
        if gate.arm.began and not seen:  # the ramp may be over before this process comes to look
            seen.append("arming")
        if gate.arming not in seen[-1:]:
            seen.append(gate.arming)
        if wanted.action == "arm" and gate.state == "stopped":
            raise Refused(f"{name} was stopped while it was arming; release the stop, then arm again")
        if gate.arming == f"{wanted.action}ed":
            return seen
        if gate.arming == "disarmed" and "arming" in seen:
            raise Refused(f"{name} was disarmed while it was arming; see its events")
    raise NotReady(f"{name}: no answer in time; does its loop run? `station doctor` tells")


def _answer(data: bytes, asked: str) -> ArmAnswer | None:
    """Return the answer to a request that a robot's gate tells of, if it does."""
    gate = _gate(data)
    return gate.arm if gate is not None and gate.arm is not None and gate.arm.id == asked else None


def _gate(data: bytes) -> _Gate | None:
    try:
        return codec.parse_struct(data, _Gate)
    except codec.BadValue:
        return None
