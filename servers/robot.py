"""The low-level server of any robot that a policy moves; `station.control.robot_server` says how it runs."""

from __future__ import annotations

from station.config import to_plain
from station.control import robot_server
from station.control.robot_server import RobotConfig
from station.life.server import Life, ServerKind


def main(config: RobotConfig, life: Life) -> int:
    """Run until asked to stop."""
    return robot_server.serve(config, life, to_plain(config))


KIND = ServerKind(
    name="robot",
    role="low-level",
    summary="any robot that a policy moves: commands through the gate and the policy to its joints",
    config=RobotConfig,
    main=main,
)
