"""The low-level server of a Unitree G1: that of any robot, with the G1's settings under short names."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from station import registry
from station.config import to_plain
from station.control import robot_server
from station.control.gate import GateConfig
from station.control.rig import RigConfig
from station.control.robot_server import RobotConfig
from station.life.server import Life, ServerKind


class G1Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the G1 server; what is not told here is as in
    `station.control.robot_server.RobotConfig`.

    Attributes:
        backend: ``mujoco``; others as they are registered (robot ``g1-<backend>``).
        robot_model: Model of a simulated robot, a path or ``collection:path``.
        policy: Registered name of the policy family.
        checkpoint: Its file; "" for the family's default.
        policy_options: Further arguments of the policy, for example ``wrist_gains: real``.
        rate_hz: Rate of the loop [Hz].
        physics_dt_s: Physics step of a simulation [s].
        pace: ``wall`` or ``command`` (lock-step).
        command_timeout_s: Longest wait for the next command in lock-step [s]; then ticks go on at `rate_hz`.
        gate: Times of the gate, how fast a command may move, and whom to obey when two write it.
        start_armed: Whether targets go to the robot from the start; None: only in simulation. Otherwise `station arm`.
        viewer: Whether a simulation opens a window.
        on_fall: ``continue``, or ``reset``: a simulated robot is put back on its feet after a second.
        real_time_priority: SCHED_FIFO priority that is asked for with `pace: wall`; 0 does not ask.
    """

    backend: str = "mujoco"
    robot_model: str = "builtin:g1.xml"
    policy: str = "tracker"
    checkpoint: str = ""
    policy_options: dict[str, Any] = {}
    rate_hz: float = 50.0
    physics_dt_s: float = 0.001
    pace: Literal["wall", "command"] = "wall"
    command_timeout_s: float = 1.0
    gate: GateConfig = GateConfig()
    start_armed: bool | None = None
    viewer: bool = False
    on_fall: Literal["continue", "reset"] = "continue"
    real_time_priority: int = 50

    def __post_init__(self) -> None:
        registry.expect("policy", self.policy)
        registry.expect("robot", f"g1-{self.backend}")

    @property
    def general(self) -> RobotConfig:
        """The same for the server of any robot."""
        return RobotConfig(
            robot=f"g1-{self.backend}",
            robot_options={"model": self.robot_model, "physics_dt_s": self.physics_dt_s, "viewer": self.viewer},
            **{name: getattr(self, name) for name in self.__struct_fields__ if name in RobotConfig.__struct_fields__},
        )

    @property
    def rig(self) -> RigConfig:
        """What drives what."""
        return self.general.rig

    @property
    def is_armed(self) -> bool:
        """Whether targets go to the robot from the start."""
        return self.general.is_armed


def main(config: G1Config, life: Life) -> int:
    """Run until asked to stop."""
    return robot_server.serve(config.general, life, to_plain(config))


KIND = ServerKind(
    name="g1",
    role="low-level",
    summary="Unitree G1, simulated: commands through the gate and the policy to the joints",
    config=G1Config,
    main=main,
)
