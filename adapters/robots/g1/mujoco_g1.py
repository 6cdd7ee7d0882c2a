"""A simulated Unitree G1: any MuJoCo model that has its 29 joints on a free pelvis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from adapters.robots.legged.mujoco_robot import LeggedMujoco
from adapters.robots.legged.unitree import G1

START_Q, START_ROOT_POS = G1.start_q, (0.0, 0.0, G1.start_height_m)


class MujocoG1(LeggedMujoco):
    """A G1, with hands or without; torques are clipped as in the stock simulation of TWIST2.

    Args:
        model: MJCF file.
        physics_dt_s: Physics step [s]; the stock simulations use 0.001, training 0.002.
        control_dt_s, latency_steps, armature, viewer: As of any robot on legs.
    """

    def __init__(
        self, model: Path, *, physics_dt_s: float = 0.001, control_dt_s: float = 0.02, latency_steps: int = 0,
        armature: float = 0.0, viewer: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(
            G1, model, physics_dt_s=physics_dt_s, control_dt_s=control_dt_s, latency_steps=latency_steps,
            armature=armature, viewer=viewer,
        )  # fmt: skip

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this robot."""
        joints = (self._model.joint(index).name for index in range(self._model.njnt))
        return super().facts() | {"has_hands": any("_hand_" in name for name in joints)}
