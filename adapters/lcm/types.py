"""The types of HOMIE's messages, and of walk-these-ways', from which HOMIE's come: primitive type, name, length.

Angles in rad, velocities in rad/s and m/s, torques in N m. A length of none is a single number. The two projects call
two types alike that are not. Facts: InternRobotics/OpenHomie, Improbable-AI/walk-these-ways (``go1_gym_deploy``).
"""

from __future__ import annotations

from adapters.lcm.message import Field, MessageType, Primitive


def _type(name: str, *fields: tuple[Primitive, str] | tuple[Primitive, str, int]) -> MessageType:
    return MessageType(name, tuple(Field(*field) for field in fields))


# -- Of both --------------------------------------------------------------------------------------------------------
RC_COMMAND = _type(
    "rc_command_lcmt",
    ("int16_t", "mode"),
    ("float", "left_stick", 2),
    ("float", "right_stick", 2),
    ("float", "knobs", 2),
    ("int16_t", "left_upper_switch"),
    ("int16_t", "left_lower_left_switch"),
    ("int16_t", "left_lower_right_switch"),
    ("int16_t", "right_upper_switch"),
    ("int16_t", "right_lower_left_switch"),
    ("int16_t", "right_lower_right_switch"),
)

# -- HOMIE, a G1 of 29 joints ---------------------------------------------------------------------------------------
COMMAND = _type("command_lcmt", ("double", "command", 4))  # vx, vy [m/s], yaw rate [rad/s], height [m]
ARM_ACTION = _type("arm_action_lcmt", ("double", "act", 14))  # left arm from the shoulder to the wrist, then right
HAND_ACTION = _type("hand_action_lcmt", ("double", "act", 14))  # left Dex3-1 in the order of its motors, then right
STATE_ESTIMATOR = _type(
    "state_estimator_lcmt",
    ("float", "rpy", 3),
    ("float", "omegaBody", 3),
    ("float", "aBody", 3),
    ("float", "p", 3),
    ("float", "vWorld", 3),
    ("float", "vBody", 3),
    ("float", "omegaWorld", 3),
    ("float", "quat", 4),
    ("float", "contact_estimate", 4),
    ("float", "aWorld", 3),
    ("int64_t", "timestamp_us"),
)
BODY_CONTROL = _type(
    "body_control_data_lcmt",
    ("float", "q", 29),
    ("float", "qd", 29),
    ("int64_t", "timestamp_us"),
)
TARGETS = _type(
    "pd_tau_targets_lcmt",
    ("double", "q_des", 29),
    ("double", "tau_ff", 29),
    ("int64_t", "timestamp_us"),
)

# -- walk-these-ways, a Go1 of 12 joints ----------------------------------------------------------------------------
GO1_LEG_CONTROL = _type(
    "leg_control_data_lcmt",
    ("float", "q", 12),
    ("float", "qd", 12),
    ("float", "p", 12),
    ("float", "v", 12),
    ("float", "tau_est", 12),
    ("int64_t", "timestamp_us"),
    ("int64_t", "id"),
    ("int64_t", "robot_id"),
)
GO1_STATE_ESTIMATOR = _type(
    "state_estimator_lcmt",
    ("float", "p", 3),
    ("float", "vWorld", 3),
    ("float", "vBody", 3),
    ("float", "rpy", 3),
    ("float", "omegaBody", 3),
    ("float", "omegaWorld", 3),
    ("float", "quat", 4),
    ("float", "contact_estimate", 4),
    ("float", "aBody", 3),
    ("float", "aWorld", 3),
    ("int64_t", "timestamp_us"),
    ("int64_t", "id"),
    ("int64_t", "robot_id"),
)
GO1_TARGETS = _type(
    "pd_tau_targets_lcmt",
    ("double", "q_des", 12),
    ("double", "qd_des", 12),
    ("double", "tau_ff", 12),
    ("double", "kp", 12),
    ("double", "kd", 12),
    ("int64_t", "timestamp_us"),
    ("int64_t", "id"),
    ("int64_t", "robot_id"),
    ("double", "se_contactState", 4),
)

HOMIE = (STATE_ESTIMATOR, BODY_CONTROL, TARGETS, RC_COMMAND, COMMAND, ARM_ACTION, HAND_ACTION)
WALK_THESE_WAYS = (GO1_LEG_CONTROL, GO1_STATE_ESTIMATOR, GO1_TARGETS, RC_COMMAND)
ALL = (*HOMIE, *WALK_THESE_WAYS[:-1])
"""Each once."""
