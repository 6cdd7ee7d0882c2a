"""Names of a G1's topics. Source: unitreerobotics/unitree_sdk2, examples of the G1."""

from __future__ import annotations

LOW_CMD = "rt/lowcmd"
LOW_STATE = "rt/lowstate"
LOW_STATE_SLOW = "rt/lf/lowstate"
TORSO_IMU = "rt/secondary_imu"
BATTERY = "rt/lf/bmsstate"
SWITCHER_REQUEST = "rt/api/motion_switcher/request"
SWITCHER_RESPONSE = "rt/api/motion_switcher/response"
