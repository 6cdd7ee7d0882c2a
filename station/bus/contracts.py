"""What each key holds: role, codec, and the name and unit of every element, in order.

A contract is written beside the bytes of a recording, never into them, so a wrong contract cannot spoil one.
"""

from __future__ import annotations

import logging
from functools import cache
from typing import TYPE_CHECKING

from station import registry
from station.bus import arm_contracts, joints, keys
from station.bus.contract import POSE, TIMING_STAGES, Codec, Contract, Role
from station.elements import Element, elements, positions, velocities
from station.errors import StationError

if TYPE_CHECKING:  # it loads NumPy
    from station.protocols import CommandFormat

log = logging.getLogger(__name__)

__all__ = ["TIMING_STAGES", "Codec", "Contract", "Role", "contract", "contracts"]


def contract(key: str) -> Contract | None:
    """Return the contract of a key, or None for a key that nobody has described."""
    of_station = _of_station().get(key) or _by_prefix(key) or _of_operator(key) or _of_camera(key)
    return of_station or _of_robots().get(key) or _of_another_arm(key)


def contracts() -> tuple[Contract, ...]:
    """Return every contract with a fixed key, in catalogue order."""
    return (*_of_robots().values(), *_of_station().values())


_GYRO = ("gyro_x", "gyro_y", "gyro_z")
_QUAT = ("root_quat_w", "root_quat_x", "root_quat_y", "root_quat_z")
_NECK = elements((("neck_yaw", "neck_pitch"), "rad"))


def _hand(side: str) -> tuple[Element, ...]:
    return elements((positions(joints.hand(side)), "rad"))


def _twist2() -> list[Contract]:
    def make(key: str, role: Role, codec: Codec, items: tuple[Element, ...] = (), note: str = "",
             rate_hz: float | None = 50.0) -> Contract:  # fmt: skip
        return Contract(key=key, family="twist2", role=role, codec=codec, elements=items, rate_hz=rate_hz, note=note)

    state = elements((_GYRO, "rad/s"), (("root_roll", "root_pitch"), "rad"), (positions(joints.G1_29), "rad"))
    return [
        *(make(keys.action_hand(side), "command", "json-vector", _hand(side)) for side in ("left", "right")),
        make(keys.action_neck(), "command", "json-vector", _NECK),
        make(keys.T_ACTION, "command", "integer", note="wall clock of the command, milliseconds since the epoch"),
        make(keys.state_body(keys.TWIST2_ROBOT), "state", "json-vector", state,
             "gyro in the root frame, unscaled; stock servers write 127 zeros once at start"),
        *(make(keys.state_hand(side), "state", "json-vector", _hand(side)) for side in ("left", "right")),
        make(keys.state_neck(), "state", "json-vector", _NECK),
        make(keys.T_STATE, "state", "integer", note="wall clock of the state, milliseconds since the epoch"),
        make(keys.CONTROLLER_DATA, "sensor", "json", note="LeftController, RightController, timestamp [ns]",
             rate_hz=100.0),
        make(keys.MOTION_START_SIGNAL, "control", "text", note="1 while B is the only button, else 0"),
        make(keys.MOTION_EXIT_SIGNAL, "control", "text", note="1 while Select is the only button, else 0"),
    ]  # fmt: skip


def _twist() -> list[Contract]:
    robot = keys.TWIST_ROBOT
    hands = _hand("left") + _hand("right")
    scaled = (
        elements((tuple(f"scaled_{name}" for name in _GYRO), "0.25 rad/s"), (("root_roll", "root_pitch"), "rad"))
        + elements((tuple(f"{n}_pos_from_default" for n in joints.G1_23), "rad"))
        + elements((tuple(f"scaled_{n}_vel" for n in joints.G1_23), "0.05 rad/s"))
        + elements((tuple(f"{n}_previous_action" for n in joints.G1_23), ""))
    )

    def make(key: str, role: Role, items: tuple[Element, ...], note: str) -> Contract:
        return Contract(
            key=key, family="twist", role=role, codec="json-vector", elements=items, rate_hz=50.0, note=note
        )

    return [
        make(keys.action_hands(robot), "command", hands, "left hand, then right hand"),
        make(keys.state_body(robot), "state", scaled,
             "scaled proprioception; ankle velocities are zero; stock servers write 105 zeros once at start"),
        make(keys.state_hands(robot), "state", hands, "left hand, then right hand"),
    ]  # fmt: skip


@cache
def _commands() -> list[tuple[str, Contract]]:
    """Contracts of the commands whose formats are registered, with the robot that each is for.

    Ours come first: where several are for one robot, the first one names its `keys.command_used`.
    """
    found = []
    for name in sorted(registry.names("command"), key=lambda name: not registry.is_ours("command", name)):
        try:
            form: CommandFormat = registry.find("command", name)
            made = Contract(
                key=form.key, family=form.name, role="command", codec="json-vector", elements=form.elements,
                rate_hz=50.0, note=form.note,
            )  # fmt: skip
        except (ImportError, AttributeError, TypeError, ValueError, StationError) as error:
            # A recorder records what comes, whatever is wrong with somebody's format.
            log.warning("command format %r: its key has no contract: %s: %s", name, type(error).__name__, error)
        else:
            found.append((form.robot, made))
    return found


def _ours(robot: str, names: tuple[str, ...]) -> list[Contract]:
    """Contracts of the station's own keys for a robot whose n joints are named."""
    command = next((made.elements for suffix, made in _commands() if suffix == robot), ())

    def make(key: str, role: Role, codec: Codec, items: tuple[Element, ...] = (), note: str = "") -> Contract:
        return Contract(key=key, family="station", role=role, codec=codec, elements=items, rate_hz=50.0, note=note)

    sent = elements((positions(names), "rad"), (tuple(f"{n}_kp" for n in names), "N m/rad"),
                    (tuple(f"{n}_kd" for n in names), "N m s/rad"))  # fmt: skip
    state = elements((positions(names), "rad"), (velocities(names), "rad/s"), (_QUAT, ""), (_GYRO, "rad/s"))
    qpos = elements((("root_x", "root_y", "root_z"), "m"), (_QUAT, ""), (positions(names), "rad"))
    timing = elements((("tick", "command_seq"), ""), (TIMING_STAGES, "ns"))
    return [
        make(keys.robot_state(robot), "state", "f64", state, "root frame for gyro; world for the quaternion"),
        make(keys.policy_obs(robot), "policy", "f32", note="observation of the network, in the policy's own order"),
        make(keys.policy_action(robot), "policy", "f32", note="raw output of the network, before clipping"),
        make(keys.policy_timing(robot), "policy", "json-vector", timing,
             "one machine's monotonic clock; 0 where unknown, as for a foreign writer"),
        make(keys.target(robot), "policy", "f64", sent, "as really sent, after the robot's own limits"),
        make(keys.sim_qpos(robot), "state", "f64", qpos, "ground truth; world frame"),
        make(keys.command_gate(robot), "policy", "json", note="state, reason and age of the command at the gate"),
        make(keys.command_used(robot), "policy", "f64", command, "the command after the gate"),
        make(keys.command_source(robot), "command", "json", note="file, sha256, frame and phase of the command"),
    ]  # fmt: skip


def _station() -> list[Contract]:
    def make(key: str, role: Role, codec: Codec, note: str) -> Contract:
        return Contract(key=key, family="station", role=role, codec=codec, note=note)

    return [
        make(keys.ESTOP, "control", "json", "latched emergency stop: who asked for it and why; 0 when reset"),
        make(keys.ARM, "control", "json", "arm or disarm: who asked and why; answered in the robot's command_gate"),
        make(
            keys.CONTROLLER,
            "control",
            "json",
            "clear a controller's faults, or choose its profile or throttle; answered in the robot's command_gate",
        ),
        make(keys.EVENT, "event", "json", "one event: name, severity, source, numbers"),
        make(
            keys.MOTION_CONTROL, "control", "json", "start, pause, resume, seek, loop or leave, for the motion server"
        ),
        make(keys.RECORD, "control", "json", "a request to the recorder"),
        make(keys.RECORD_ACK, "control", "json", "the recorder's answer"),
        make(keys.RECORDER, "control", "json", "what the recorder is doing"),
        make(keys.TAP_PROBE, "network", "text", "written by a recorder to see that its tap delivers"),
    ]


_PREFIXES = {
    keys.SERVER_PREFIX: "health of a server, twice a second",
    keys.CONFIG_PREFIX: "what a server runs: policy, hashes, gains, rates, code revision",
}


def _by_prefix(key: str) -> Contract | None:
    for prefix, note in _PREFIXES.items():
        if key.startswith(prefix):
            return Contract(key=key, family="station", role="control", codec="json", note=note)
    return None


_TWIST = elements((("vx", "vy", "vz", "wx", "wy", "wz"), ""))
_BODY_POS = elements((tuple(f"{name}_{axis}" for name in joints.SMPL_24 for axis in "xyz"), "m"))
_BODY_QUAT = elements((tuple(f"{name}_q{axis}" for name in joints.SMPL_24 for axis in "wxyz"), ""))
_HAND = tuple(Element(f"{name}_{item.name}", item.unit) for name in joints.HAND_26 for item in POSE)
_WORLD = "the operator's world: x forward, y left, z up"

_OPERATOR: dict[str, tuple[Codec, tuple[Element, ...], str]] = {
    keys.operator_status(""): ("json", (), "live, stale or lost, and why; counts of new samples and of repetitions"),
    keys.operator_controls(""): ("json", (), "number by name: axes -1 to 1, triggers 0 to 1, buttons 0 or 1"),
    keys.operator_head(""): ("f64", POSE, _WORLD),
    keys.operator_left(""): ("f64", POSE, _WORLD),
    keys.operator_right(""): ("f64", POSE, _WORLD),
    keys.operator_body_pos(""): ("f64", _BODY_POS, _WORLD),
    keys.operator_body_quat(""): ("f64", _BODY_QUAT, f"{_WORLD}; a bone's orientation stands at its upper joint"),
    keys.operator_hand_left(""): ("f64", _HAND, _WORLD),
    keys.operator_hand_right(""): ("f64", _HAND, _WORLD),
    keys.operator_twist(""): ("f64", _TWIST, "-1 to 1 of full deflection; x forward, y left, z up"),
    keys.operator_joints(""): ("f64", (), "joint positions of the leader [rad], then its gripper from 0 to 1"),
}
"""Codec, elements and note by the beginning of a key; the name of the device server follows."""


def _of_another_arm(key: str) -> Contract | None:
    """Arms of a family differ in their limits, not in what is said of them."""
    _, family, model = key.partition(f"_{keys.KASSOW_FAMILY}")
    if not model or keys.is_stamp(key):
        return None
    return next((item for item in arm_contracts.of(family[1:] + model) if item.key == key), None)


def _of_operator(key: str) -> Contract | None:
    for prefix, (codec, items, note) in _OPERATOR.items():
        if key.startswith(prefix) and not keys.is_stamp(key):
            rate_hz = 100.0 if prefix == keys.operator_status("") else None  # samples come as the device gives them
            return Contract(
                key=key, family="station", role="sensor", codec=codec, elements=items, rate_hz=rate_hz, note=note
            )
    return None


def _of_camera(key: str) -> Contract | None:
    if not key.startswith(keys.camera_image("")) or keys.is_stamp(key):
        return None
    note = "one JPEG file per picture; the stamp's capture_ns is when it was taken, on its writer's monotonic clock"
    return Contract(key=key, family="station", role="sensor", codec="jpeg", rate_hz=30.0, note=note)


@cache
def _of_station() -> dict[str, Contract]:
    return {item.key: item for item in _station()}


@cache
def _of_robots() -> dict[str, Contract]:
    every = [
        *(made for _, made in _commands()),
        *_twist2(),
        *_twist(),
        *_ours(keys.TWIST2_ROBOT, joints.G1_29),
        *_ours(keys.TWIST_ROBOT, joints.G1_29),
        *arm_contracts.of(keys.KASSOW_KR810),
    ]
    return {item.key: item for item in every}
