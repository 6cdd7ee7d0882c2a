"""What may be wrong with a robot twin, each by a switch; and where it hangs. Imports nothing heavy."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from adapters.robots.g1.dds.buttons import BUTTONS
from adapters.robots.g1.joints import G1_29, hand
from adapters.robots.hands import inspire

Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Side = Literal["left", "right"]

_HAND_JOINTS = tuple(dict.fromkeys(
    name for side in ("left", "right") for name in (*hand(side), *(joint.name for joint in inspire.JOINTS[side]))
))  # fmt: skip


class G1Faults(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The state of the switches; without any the robot is well, hangs on its gantry and obeys its own controller.

    Attributes:
        gantry: ``hung``, feet above the ground; ``down``, on its feet, and the rope carries part of it; ``slack``, the
            rope leaves it 0.47 m to squat, and catches it when it falls; ``off``.
        controller: What the robot's own controller does until it is released: ``holds``, commands are ignored;
            ``fights``, it writes damping between them.
        without_commands: What the firmware does when they cease, which nobody knows: ``hold`` the last for ever,
            ``damp``, or go ``limp``.
        without_commands_after_s: How long after the last command it damps or goes limp [s].
        commands_lost: No command reaches the motors, as when their writer has died; states come.
        link: ``up``; ``down``, nothing passes; ``frozen``, what is sent waits, and all of it comes at once afterwards.
        state_silent: The robot is on the network, and sends no state.
        tick_frozen: States come, and their tick stands still.
        state_drop, state_twice: Share of the states that are lost, and that come twice.
        state_bad_crc: Share of the states whose checksum is wrong.
        state_delay_ms: From the measurement to its message [ms].
        remote: Buttons that are held down.
        remote_off: The remote is off: forty zero bytes.
        sticks: Left x, left y, right x, right y of the remote, -1 to 1.
        remote_stop_dead: L2+B does nothing, as one lab saw while a program streamed commands.
        imu_roll_rad, imu_pitch_rad, imu_yaw_rad: By how much the IMU is mounted wrong, or has drifted [rad].
        yaw_drift_rad_s: How fast its yaw drifts [rad/s].
        gyro_bias_rad_s: Of each axis [rad/s].
        encoder_offset_rad: Greatest of a random offset of each joint [rad].
        swapped_joints: What is sent to one joint moves the other, and the other way round, by pairs.
        reversed_joints: They say the opposite of where they are and how they move.
        velocity_noise_rad_s: Standard deviation of joint velocities [rad/s].
        winding_c: Temperature of windings, by joint, in place of what the motor has warmed up to [°C].
        motor_error: Bits of ``motorstate``, by joint.
        soc: Charge of the battery [%].
        voltage: Of the motors [V].
        hand_silent: Hands, ``left`` and ``right``, that say nothing.
        hand_error: Bits of the error of a hand's motor, by joint.
        holds: By hand, the part of closing, 0 to 1, at which something that it holds stops its fingers.
        push_m_s: Velocity that the pelvis is given at once, x and y in the world [m/s]; each change pushes once.
    """

    gantry: Literal["hung", "down", "slack", "off"] = "hung"
    controller: Literal["holds", "fights"] = "holds"
    without_commands: Literal["hold", "damp", "limp"] = "hold"
    without_commands_after_s: float = 2.0
    commands_lost: bool = False
    link: Literal["up", "down", "frozen"] = "up"
    state_silent: bool = False
    tick_frozen: bool = False
    state_drop: Share = 0.0
    state_twice: Share = 0.0
    state_bad_crc: Share = 0.0
    state_delay_ms: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 2.0
    remote: tuple[str, ...] = ()
    remote_off: bool = False
    sticks: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    remote_stop_dead: bool = False
    imu_roll_rad: float = 0.0
    imu_pitch_rad: float = 0.0
    imu_yaw_rad: float = 0.0
    yaw_drift_rad_s: float = 0.0
    gyro_bias_rad_s: float = 0.0
    encoder_offset_rad: float = 0.0
    swapped_joints: dict[str, str] = {}
    reversed_joints: tuple[str, ...] = ()
    velocity_noise_rad_s: float = 0.0
    winding_c: dict[str, float] = {}
    motor_error: dict[str, int] = {}
    soc: float = 90.0
    voltage: float = 54.0
    hand_silent: tuple[Side, ...] = ()
    hand_error: dict[str, int] = {}
    holds: dict[Side, Share] = {}
    push_m_s: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        pairs = [name for pair in self.swapped_joints.items() for name in pair]
        for field, given, known in (
            ("remote", self.remote, BUTTONS),
            ("swapped_joints", pairs, G1_29),
            ("reversed_joints", self.reversed_joints, G1_29),
            ("winding_c", self.winding_c, G1_29),
            ("motor_error", self.motor_error, G1_29),
            ("hand_error", self.hand_error, _HAND_JOINTS),
        ):
            if odd := [name for name in given if name not in known]:
                raise ValueError(f"{field}: {odd[0]!r} is none of {', '.join(known)}")
        if len(set(pairs)) < len(pairs):
            raise ValueError(f"swapped_joints: {max(pairs, key=pairs.count)!r} stands in it twice")
        if self.without_commands_after_s < 0.0:
            raise ValueError(f"without_commands_after_s is {self.without_commands_after_s:g}; expected 0 s or more")
