"""What a robot's low-level server puts on the bus, as streams of a `station.description.RobotDescription`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from station.bus import keys
from station.contract import POSE, TIMING_STAGES, Codec, Contract, Element, Role, elements
from station.description import JOINT, ROBOT

if TYPE_CHECKING:  # it loads NumPy
    from station.protocols import CommandFormat

POSITIONS = elements(((f"{JOINT}_pos",), "rad"))
VELOCITIES = elements(((f"{JOINT}_vel",), "rad/s"))
GYRO = ("gyro_x", "gyro_y", "gyro_z")
QUAT = ("root_quat_w", "root_quat_x", "root_quat_y", "root_quat_z")
ROOT = elements((("root_x", "root_y", "root_z"), "m"), (QUAT, ""))

COUNTERS = (
    "tick", "stream_j_sends", "direct_sends", "move_sends", "commands_dropped_by_throttle", "slewed_sends",
    "limit_refusals", "sync_timeouts", "missed_ticks", "late_commands", "fault_count",
)  # fmt: skip
"""First elements of `keys.state_counters`: `tick` counts the controller's heartbeats (250 Hz), `stream_j_sends` the
targets that were sent to it."""

SESSION_TIMES = (
    "sync_to_send_last", "sync_to_send_p50", "sync_to_send_p99", "sync_to_send_max",
    "period_p50", "period_p99", "period_max", "queued_motion",
)  # fmt: skip
"""The rest of them: from a heartbeat to the sending of a command; between two heartbeats; and how much motion the
controller still owes, NaN where it does not tell."""

_ROOT_VELOCITY = elements((("root_vel_x", "root_vel_y", "root_vel_z"), "m/s"))
_TIMING = elements((("tick", "command_seq"), ""), (TIMING_STAGES, "ns"))


def command_stream(command_format: CommandFormat) -> Contract:
    """Return what the key of a command holds."""
    return Contract(
        key=command_format.key,
        family=command_format.name,
        role="command",
        codec="json-vector",
        elements=command_format.elements,
        rate_hz=50.0,
        note=command_format.note,
    )


def part_streams(command_format: CommandFormat, rate_hz: float = 50.0) -> tuple[Contract, ...]:
    """Return the streams of a part that is commanded apart (`station.parts`), beside those of all of the robot.

    Args:
        command_format: Of the part's command.
        rate_hz: Of the robot's steps [Hz].
    """

    def make(key: str, role: Role, codec: Codec, items: tuple[Element, ...] = (), note: str = "") -> Contract:
        return Contract(key=key, family="station", role=role, codec=codec, elements=items, rate_hz=rate_hz, note=note)

    return (
        command_stream(command_format),
        make(
            keys.command_gate(command_format.robot),
            "policy",
            "json",
            note="state, reason and age of this part's command",
        ),
        make(
            keys.command_used(command_format.robot),
            "policy",
            "f64",
            command_format.elements,
            "this part's command after its gate",
        ),
        make(
            keys.command_timing(command_format.robot),
            "policy",
            "json-vector",
            elements((("tick", "command_seq"), ""), (TIMING_STAGES[:2], "ns"), (("decided",), "s")),
            "which command of this part the step used; one machine's monotonic clock; 0 where unknown",
        ),
        make(keys.command_source(command_format.robot), "command", "json", note="where this part's command comes from"),
    )


def command_streams(command_format: CommandFormat) -> tuple[Contract, ...]:
    """Return what the keys of a robot's command hold: of one, or of each of its parts that are commanded apart."""
    from station.parts import PartedCommand  # with NumPy, which whoever has a format has loaded

    if isinstance(command_format, PartedCommand):
        return tuple(stream for part in command_format.parts for stream in part_streams(part))
    return (command_stream(command_format),)


def driven_by_policy(command: tuple[Element, ...] = (), rate_hz: float = 50.0) -> tuple[Contract, ...]:
    """Return the streams of a robot whose joints a policy drives.

    Args:
        command: Elements of the command that the policy takes.
        rate_hz: Of its steps [Hz].
    """

    def make(key: str, role: Role, codec: Codec, items: tuple[Element, ...] = (), note: str = "") -> Contract:
        return Contract(key=key, family="station", role=role, codec=codec, elements=items, rate_hz=rate_hz, note=note)

    gains = elements(((f"{JOINT}_kp",), "N m/rad"), ((f"{JOINT}_kd",), "N m s/rad"))
    state = (*POSITIONS, *VELOCITIES, *elements((QUAT, ""), (GYRO, "rad/s")))
    qpos = (*ROOT, *POSITIONS)
    return (
        make(keys.robot_state(ROBOT), "state", "f64", state, "root frame for gyro; world for the quaternion"),
        make(keys.policy_obs(ROBOT), "policy", "f32", note="observation of the network, in the policy's own order"),
        make(keys.policy_action(ROBOT), "policy", "f32", note="raw output of the network, before clipping"),
        make(keys.policy_timing(ROBOT), "policy", "json-vector", _TIMING,
             "one machine's monotonic clock; 0 where unknown, as for a foreign writer"),
        make(keys.target(ROBOT), "policy", "f64", (*POSITIONS, *gains), "as really sent, after the robot's own limits"),
        make(keys.sim_qpos(ROBOT), "state", "f64", qpos, "ground truth; world frame"),
        make(keys.root_velocity(ROBOT), "state", "f64", _ROOT_VELOCITY, "root frame; where a policy needs it"),
        make(keys.command_gate(ROBOT), "policy", "json", note="state, reason and age of the command at the gate"),
        make(keys.command_used(ROBOT), "policy", "f64", command, "the command after the gate"),
        make(keys.command_source(ROBOT), "command", "json", note="file, sha256, frame and phase of the command"),
    )  # fmt: skip


def driven_by_controller(rate_hz: float = 250.0, state_hz: float = 125.0) -> tuple[Contract, ...]:
    """Return the streams of an arm behind a controller of its own; the command is what moves, everything else tells.

    Args:
        rate_hz: Of its commands [Hz].
        state_hz: Of what it tells of its joints [Hz].
    """

    def make(key: str, role: Role, codec: Codec, items: tuple[Element, ...] = (), note: str = "",
             rate_hz: float | None = rate_hz) -> Contract:  # fmt: skip
        return Contract(key=key, family="station", role=role, codec=codec, elements=items, rate_hz=rate_hz, note=note)

    torques = elements(((f"{JOINT}_torque",), "N m"))
    return (
        make(keys.action_joints(ROBOT), "command", "json-vector", POSITIONS,
             "absolute, never wrapped; written in each tick of its commander, and sent on only where it moved"),
        make(keys.state_joints(ROBOT), "state", "f64", (*POSITIONS, *VELOCITIES, *torques),
             "as the controller reports them: its model's where it tells no sensor's, which hides tracking errors",
             rate_hz=state_hz),
        make(keys.state_tcp(ROBOT), "state", "f64", POSE, "frame of the arm's base", rate_hz=state_hz),
        make(keys.state_counters(ROBOT), "state", "f64", elements((COUNTERS, ""), (SESSION_TIMES, "s")),
             "counters only grow; a rate is a difference over a time", rate_hz=state_hz),
        make(keys.state_controller(ROBOT), "state", "json", rate_hz=None,
             note="ten times a second: backend, profile, throttle, flags, alarm and newest event of the controller"),
        make(keys.target(ROBOT), "policy", "f64", POSITIONS, "newest target handed to the controller's session; the "
             "controller is sent those that moved"),
        make(keys.command_gate(ROBOT), "policy", "json", note="state, reason and age of the command at the gate"),
        make(keys.command_used(ROBOT), "policy", "f64", POSITIONS, "the command after the gate; where none is "
             "followed, where the arm is"),
        make(keys.policy_timing(ROBOT), "policy", "json-vector", _TIMING,
             "one machine's monotonic clock; no policy: observed and inferred are when the gate had decided"),
        make(keys.command_source(ROBOT), "command", "json", note="device, driver and sample of the command",
             rate_hz=None),
    )  # fmt: skip
