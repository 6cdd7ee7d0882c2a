"""The hands of a robot twin: they hear their topics, move their fingers, and say where those are.

A finger is a joint on its own, without a palm and without weight; the body of the twin does not feel it. What a hand
holds is a stop on its way (`G1Faults.holds`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from typing import Any

import numpy as np

from adapters.commands import hands as commands
from adapters.commands.hand import HandCommand
from adapters.robots.g1.dds import types
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.joints import select
from adapters.robots.g1.twin.faults import G1Faults, Side
from adapters.robots.hands import inspire, wire
from adapters.robots.hands.kinds import dex3_wire, motors_of
from adapters.robots.hands.options import Dex3Options
from adapters.robots.legged.table import Joint
from station.contract import names_of
from station.protocols import Floats

SIDES: tuple[Side, ...] = ("left", "right")

TICKS_PER_STATE = 5
"""Ticks of the twin between two states of a hand: 100 of them in a second."""

_TIMES_OUT_S = 1.0
_FRICTION_N_M_S = 0.02
_NOISE_RAD, _NOISE_RAD_S = 2e-4, 5e-3
_ROOM_C = 25.0
_NO_SENSOR = 30000.0
_SENSORS = 9


class Fingers:
    """Joints of a hand in the order of its motors, each on its own.

    Args:
        joints: The joints.
        command: Of the hand, which says where its joints are open and closed.

    Attributes:
        q, dq, tau: Shape (n,) [rad, rad/s, N m].
    """

    def __init__(self, joints: tuple[Joint, ...], command: HandCommand) -> None:
        self.names = tuple(joint.name for joint in joints)
        self._lower = np.array([joint.lower for joint in joints])
        self._upper = np.array([joint.upper for joint in joints])
        self._most_nm = np.array([joint.effort_nm for joint in joints])
        self._fastest = np.array([joint.velocity_rad_s for joint in joints])
        self._inertia = np.array([joint.armature for joint in joints])
        order = [names_of(command.elements).index(f"{name}_pos") for name in self.names]
        self._opened, self._closed = command.opened[order], command.closed[order]
        self.q = self._opened.astype(float)
        self.dq = np.zeros(len(joints))
        self.tau = np.zeros(len(joints))

    def shown(self) -> dict[str, float]:
        """Return where the joints are, by name [rad]."""
        return dict(zip(self.names, self.q.round(4).tolist(), strict=True))

    def pull(self, q: Floats, kp: Floats, kd: Floats, dt_s: float, stop: float) -> None:
        """Move by a motor's law for a period [s]; what the hand holds stops it at a part of closing."""
        self.tau = np.clip(kp * (q - self.q) - kd * self.dq, -self._most_nm, self._most_nm)
        self.dq = self.dq + (self.tau - _FRICTION_N_M_S * self.dq) * (dt_s / self._inertia)
        self._go(np.clip(self.dq, -self._fastest, self._fastest) * dt_s, dt_s, stop)

    def follow(self, q: Floats, dt_s: float, stop: float) -> None:
        """Move towards the commanded positions for a period [s], at the hand's own speed."""
        self._go(np.clip(q - self.q, -self._fastest * dt_s, self._fastest * dt_s), dt_s, stop)

    def _go(self, by: Floats, dt_s: float, stop: float) -> None:
        end = self._opened + stop * (self._closed - self._opened)
        closes = self._closed >= self._opened
        lower = np.where(closes | (stop >= 1.0), self._lower, np.maximum(self._lower, end))
        upper = np.where(closes & (stop < 1.0), np.minimum(self._upper, end), self._upper)
        reached = np.clip(self.q + by, lower, upper)
        self.dq = (reached - self.q) / dt_s
        self.q = reached


class TwinHand(ABC):
    """What hears one topic and says another.

    Args:
        network: The twin's.
        topics: Of commands and of states.
        kinds: Types of both.
    """

    def __init__(self, network: Network, topics: tuple[str, str], kinds: tuple[str, str]) -> None:
        command, state = (getattr(types, kind) for kind in kinds)
        self._reader = network.reader(topics[0], command, depth=16)
        self._writer = network.writer(topics[1], raw(state))
        self.counts: Counter[str] = Counter()

    def tick(self, now_s: float, dt_s: float, faults: G1Faults, *, is_heard: bool, says: bool) -> None:
        """Hear, move for a period [s], and say what is measured."""
        for message in self._reader.take():
            if is_heard:
                self.counts["accepted" if self._hear(message, now_s) else "refused"] += 1
        self._move(now_s, dt_s, faults)
        if says and not self._is_silent(faults):
            self._writer.write(self._state(faults))
            self.counts["states"] += 1

    @abstractmethod
    def _hear(self, message: bytes, now_s: float) -> bool:
        """Take a command; return whether it is one."""

    @abstractmethod
    def _move(self, now_s: float, dt_s: float, faults: G1Faults) -> None:
        """Move the fingers."""

    @abstractmethod
    def _is_silent(self, faults: G1Faults) -> bool:
        """Whether it says nothing."""

    @abstractmethod
    def _state(self, faults: G1Faults) -> bytes:
        """Return its state as a message."""

    @abstractmethod
    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""


class Dex3Hand(TwinHand):
    """A Dex3-1: each motor by the octet ``mode`` of its own.

    Args:
        network: The twin's.
        side: Which.
        options: Order of its motors.
    """

    def __init__(self, network: Network, side: Side, options: Dex3Options) -> None:
        spoken = dex3_wire(side, options)
        super().__init__(network, (spoken.command_topic, spoken.state_topic), (spoken.command_type, spoken.state_type))
        self._side = side
        command = commands.TWIST2_LEFT if side == "left" else commands.TWIST2_RIGHT
        self.fingers = Fingers(select(motors_of(side, options.motors)), command)
        count = len(self.fingers.names)
        self._q, self._kp, self._kd = np.zeros(count), np.zeros(count), np.zeros(count)
        self._stops_by_itself = np.ones(count, bool)
        self._heard_s = -np.inf
        self._chance = np.random.default_rng(side == "left")
        self._record = wire.new_message(wire.dex3_state(_SENSORS))
        self._record["count"], self._record["sensors"] = count, _SENSORS

    @property
    def gains(self) -> tuple[Floats, Floats]:
        """Stiffness and damping that the motors hold, shape (7,) each."""
        return self._kp, self._kd

    def _hear(self, message: bytes, now_s: float) -> bool:
        if len(message) != wire.DEX3_CMD.itemsize:
            return False
        record = np.frombuffer(message, wire.DEX3_CMD)[0]
        motors = record["motors"]
        numbers = np.array([motors[name] for name in ("q", "dq", "tau", "kp", "kd")])
        if record["count"] != len(motors) or not np.isfinite(numbers).all():
            return False
        mode = motors["mode"]
        obeys = ((mode & 0x0F) == np.arange(len(motors))) & ((mode >> 4 & 0x07) == 1)
        self._q = motors["q"].astype(float)
        self._kp, self._kd = np.where(obeys, motors["kp"], 0.0), np.where(obeys, motors["kd"], 0.0)
        self._stops_by_itself = (mode & wire.STOPS_BY_ITSELF) > 0
        self._heard_s = now_s
        return True

    def _move(self, now_s: float, dt_s: float, faults: G1Faults) -> None:
        if now_s - self._heard_s > _TIMES_OUT_S:
            self._kp, self._kd = (np.where(self._stops_by_itself, 0.0, each) for each in self.gains)
        self.fingers.pull(self._q, self._kp, self._kd, dt_s, faults.holds.get(self._side, 1.0))

    def _is_silent(self, faults: G1Faults) -> bool:
        return self._side in faults.hand_silent

    def _state(self, faults: G1Faults) -> bytes:
        motors = self._record["motors"][0]
        noise = self._chance.normal(0.0, 1.0, (2, len(motors)))
        motors["q"], motors["dq"] = self.fingers.q + _NOISE_RAD * noise[0], self.fingers.dq + _NOISE_RAD_S * noise[1]
        motors["tau"] = self.fingers.tau
        motors["mode"] = np.arange(len(motors)) | 0x10
        motors["temperature"], motors["voltage"] = _ROOM_C, faults.voltage
        motors["error"] = [faults.hand_error.get(name, 0) for name in self.fingers.names]
        self._record["pressure"]["pressure"] = _NO_SENSOR
        self._record["power"] = (faults.voltage, 0.5, 12.0, 12.0)
        return self._record.tobytes()

    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""
        return {"q": self.fingers.shown(), "is_stiff": bool(self._kp.any()), **self.counts}


class InspireHand(TwinHand):
    """One or both Inspire hands: they move to the last commanded positions and hold them, however long ago that was.

    Args:
        network: The twin's.
        spoken: How the hands are spoken with.
        sides: Which.
    """

    def __init__(self, network: Network, spoken: wire.DfxWire | wire.DftpWire, sides: tuple[Side, ...] = SIDES) -> None:
        super().__init__(network, (spoken.command_topic, spoken.state_topic), (spoken.command_type, spoken.state_type))
        self._spoken, self._sides = spoken, sides
        both = {"left": commands.INSPIRE_LEFT, "right": commands.INSPIRE_RIGHT}
        self.fingers = {each: Fingers(inspire.JOINTS[each], both[each]) for each in sides}
        self._goal = self._q

    @property
    def _q(self) -> Floats:
        return np.concatenate([each.q for each in self.fingers.values()])

    def _hear(self, message: bytes, now_s: float) -> bool:
        goal = self._spoken.told(message)
        if goal is not None:
            self._goal = goal
        return goal is not None

    def _move(self, now_s: float, dt_s: float, faults: G1Faults) -> None:
        goals = np.split(self._goal, len(self._sides))
        for (side, fingers), goal in zip(self.fingers.items(), goals, strict=True):
            fingers.follow(goal, dt_s, faults.holds.get(side, 1.0))

    def _is_silent(self, faults: G1Faults) -> bool:
        return any(side in faults.hand_silent for side in self._sides)

    def _state(self, faults: G1Faults) -> bytes:
        names = [name for each in self.fingers.values() for name in each.names]
        return self._spoken.state(self._q, [faults.hand_error.get(name, 0) for name in names])

    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""
        return {"q": {k: v for each in self.fingers.values() for k, v in each.shown().items()}, **self.counts}


def hands(network: Network, which: str, motors: Any) -> dict[str, TwinHand]:
    """Return the hands of a robot by their names, as its options name them; {} for none."""
    if which == "dex3":
        return {f"{side}_hand": Dex3Hand(network, side, Dex3Options(motors=motors)) for side in SIDES}
    if which == "inspire-dftp":
        return {
            f"{side}_hand": InspireHand(network, wire.DftpWire(side, inspire.JOINTS[side]), (side,)) for side in SIDES
        }
    if which == "inspire-dfx":
        return {"hands": InspireHand(network, wire.DfxWire(*inspire.JOINTS.values()))}
    return {}
