"""Keys of TWIST and TWIST2, spelled here and nowhere else, and the names that their scripts give to their robots.

Source: YanjieZe/TWIST and amazon-far/TWIST2, motion, teleoperation and low-level servers.
"""

from __future__ import annotations

TWIST2_ROBOT = "unitree_g1_with_hands"
TWIST_ROBOT = "g1"

# -- TWIST2: one robot name, hard-coded upstream
T_ACTION = "t_action"
T_STATE = "t_state"
CONTROLLER_DATA = "controller_data"
MOTION_START_SIGNAL = "motion_start_signal"
MOTION_EXIT_SIGNAL = "motion_exit_signal"


def action_body(robot: str = TWIST2_ROBOT) -> str:
    """TWIST2's whole-body command."""
    return f"action_body_{robot}"


def action_hand(side: str, robot: str = TWIST2_ROBOT) -> str:
    """TWIST2's hand command; side is ``left`` or ``right``."""
    return f"action_hand_{side}_{robot}"


def action_neck(robot: str = TWIST2_ROBOT) -> str:
    """TWIST2's neck command."""
    return f"action_neck_{robot}"


def state_body(robot: str) -> str:
    """Body state: raw in TWIST2, scaled proprioception in TWIST."""
    return f"state_body_{robot}"


def state_hand(side: str, robot: str = TWIST2_ROBOT) -> str:
    """TWIST2's measured hand joints; side is ``left`` or ``right``."""
    return f"state_hand_{side}_{robot}"


def state_neck(robot: str = TWIST2_ROBOT) -> str:
    """TWIST2's measured neck joints."""
    return f"state_neck_{robot}"


# -- TWIST
def action_mimic(robot: str = TWIST_ROBOT) -> str:
    """TWIST's whole-body command."""
    return f"action_mimic_{robot}"


def action_hands(robot: str = TWIST_ROBOT) -> str:
    """TWIST's command of both hands in one list."""
    return f"action_hand_{robot}"


def state_hands(robot: str = TWIST_ROBOT) -> str:
    """TWIST's measured joints of both hands in one list."""
    return f"state_hand_{robot}"
