"""The low-level server of a Unitree G1: that of any robot, with the G1's settings under short names."""

from __future__ import annotations

from typing import Annotated

from station import registry
from station.control.rig import RigConfig
from station.control.robot_server import PolicyServerConfig, expect, serve
from station.life.server import ServerKind


class G1Config(PolicyServerConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the G1 server; the rest is as in `station.control.robot_server.PolicyServerConfig`.

    Attributes:
        backend: ``mujoco``; others as they are registered (robot ``g1-<backend>``).
        robot_model: Model of a simulated robot, a path or ``collection:path``.
        physics_dt_s: Physics step of a simulation [s].
        viewer: Whether a simulation opens a window.
    """

    backend: str = "mujoco"
    robot_model: str = "builtin:g1.xml"
    policy: Annotated[str, registry.named("policy")] = "tracker"
    rate_hz: float = 50.0
    physics_dt_s: float = 0.001
    viewer: bool = False

    def __post_init__(self) -> None:
        self.expect_policies()
        registry.expect("robot", f"g1-{self.backend}")

    @property
    def rig(self) -> RigConfig:
        """What drives what."""
        options = {"model": self.robot_model, "physics_dt_s": self.physics_dt_s, "viewer": self.viewer}
        return self.rig_of(f"g1-{self.backend}", options)


KIND = ServerKind(
    name="g1",
    role="low-level",
    summary="Unitree G1, simulated: commands through the gate and the policy to the joints",
    config=G1Config,
    main=serve,
    expect=expect,
)
