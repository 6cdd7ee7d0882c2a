"""The low-level server of any robot that a policy moves; `station.control.robot_server` says how it runs."""

from __future__ import annotations

from station.control.robot_server import RobotConfig, expect, serve
from station.life.server import ServerKind

KIND = ServerKind(
    name="robot",
    role="low-level",
    summary="any robot that a policy moves: commands through the gate and the policy to its joints",
    config=RobotConfig,
    main=serve,
    expect=expect,
)
