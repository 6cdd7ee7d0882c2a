"""TWIST's whole-body command: 33 numbers on ``action_mimic_g1``.

| index | element |
|---|---|
| 0 | root height above ground [m] |
| 1, 2, 3 | roll, pitch, yaw [rad]; yaw is absolute, in the motion's world |
| 4, 5, 6 | root velocity x, y, z in the root frame [m/s] |
| 7 | yaw rate about the root's z [rad/s] |
| 8-32 | 25 joint positions in the order of `adapters.robots.g1.joints.G1_25` [rad]; the wrist rolls bypass the policy |

Source: YanjieZe/TWIST, motion server and low-level servers.
"""

from __future__ import annotations

import math

from adapters.commands.body import ElementBound, body_command, standing
from adapters.commands.twist2 import PITCH, ROLL, YAW_RATE, height, velocity
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_25
from station.protocols import Reference, StockKeys
from station.rotations import roll_pitch_yaw


def _head(reference: Reference) -> list[float]:
    rotation = roll_pitch_yaw(reference.root_quat_wxyz).tolist()
    velocity = reference.root_lin_vel.tolist()
    return [float(reference.root_pos[2]), *rotation, *velocity, float(reference.root_ang_vel[2])]


# A heading that passes the half turn jumps by a whole one.
_YAW = ElementBound("root_yaw", "rad", 0.0, lower=-math.pi, upper=math.pi, margin=0.1, rate=math.inf)

FORMAT = body_command(
    name="twist",
    robot=twist_keys.TWIST_ROBOT,
    key=twist_keys.action_mimic(),
    auxiliary={twist_keys.action_hands(): 14},
    stock=StockKeys(
        clocks=(twist_keys.T_ACTION,),
        signals={twist_keys.MOTION_START_SIGNAL: "start", twist_keys.MOTION_EXIT_SIGNAL: "leave"},
    ),
    note="yaw is absolute, in the reference's world",
    bounds=(height(0.793), ROLL, PITCH, _YAW, velocity("x"), velocity("y"), velocity("z"), YAW_RATE),
    joint_names=G1_25,
    default_pose=standing(shoulder_roll=0.2),
    head=_head,
)
