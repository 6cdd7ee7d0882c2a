"""TWIST2's whole-body command: 35 numbers on ``action_body_unitree_g1_with_hands``.

| index | element |
|---|---|
| 0, 1 | root velocity x, y in the root frame [m/s] |
| 2 | root height above ground [m] |
| 3, 4 | roll, pitch [rad] |
| 5 | yaw rate about the root's z [rad/s] |
| 6-34 | 29 joint positions in the order of `adapters.robots.g1.joints.G1_29` [rad] |

Heading and place are not commanded: they drift freely. Source: amazon-far/TWIST2, motion and teleoperation servers.
"""

from __future__ import annotations

from adapters.commands.body import ElementBound, body_command, standing
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station.protocols import Reference, StockKeys
from station.rotations import roll_pitch_yaw


def _head(reference: Reference) -> list[float]:
    roll, pitch, _ = roll_pitch_yaw(reference.root_quat_wxyz).tolist()
    velocity_x, velocity_y, _ = reference.root_lin_vel.tolist()
    return [velocity_x, velocity_y, float(reference.root_pos[2]), roll, pitch, float(reference.root_ang_vel[2])]


# Rates: joints have their motors'. Those of the head leave room above what people walk with once it is retargeted and
# differentiated frame by frame: 22 m/s^2, 1.2 m/s up and down, 2.9 rad/s of lean, 100 rad/s^2 of turn (1.2 x speed).
def velocity(axis: str) -> ElementBound:
    """Velocity of the root in its own frame."""
    return ElementBound(f"root_vel_{axis}", "m/s", 0.0, lower=-3.0, upper=3.0, margin=1.0, rate=30.0, is_velocity=True)


def height(standing_m: float) -> ElementBound:
    """Height of the root above ground."""
    return ElementBound("root_height", "m", standing_m, lower=0.2, upper=1.2, margin=0.1, rate=3.0)


ROLL, PITCH = (
    ElementBound(f"root_{tilt}", "rad", 0.0, lower=-1.3, upper=1.3, margin=0.2, rate=6.0) for tilt in ("roll", "pitch")
)
YAW_RATE = ElementBound("root_yaw_rate", "rad/s", 0.0, lower=-6.0, upper=6.0, margin=3.0, rate=150.0, is_velocity=True)

FORMAT = body_command(
    name="twist2",
    robot=twist_keys.TWIST2_ROBOT,
    key=twist_keys.action_body(),
    auxiliary={twist_keys.action_hand("left"): 7, twist_keys.action_hand("right"): 7, twist_keys.action_neck(): 2},
    stock=StockKeys(
        returning=frozenset({twist_keys.action_neck()}),
        clocks=(twist_keys.T_ACTION,),
        signals={twist_keys.MOTION_START_SIGNAL: "start", twist_keys.MOTION_EXIT_SIGNAL: "leave"},
    ),
    note="root velocities in the root frame; height above ground; heading is not commanded",
    bounds=(velocity("x"), velocity("y"), height(0.8), ROLL, PITCH, YAW_RATE),
    joint_names=G1_29,
    default_pose=standing(shoulder_roll=0.4),
    head=_head,
)
