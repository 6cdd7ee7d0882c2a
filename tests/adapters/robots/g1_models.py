"""Built-in models of the G1 for tests: compiled, posed, and asked what touches what."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adapters.policies.twist2 import gains
from adapters.robots.g1.joints import G1_29, select
from adapters.robots.g1.mujoco_g1 import START_ROOT_POS
from adapters.robots.legged import models
from station.protocols import Floats, JointTargets

G1, DEX3 = models.SOURCE, models.HERE / "g1_dex3.xml"

FLOOR, SEEN, TOUCHES = 0, 1, 3
"""Geom groups."""

both = pytest.mark.parametrize("path", [G1, DEX3], ids=["g1", "dex3"])


@cache
def compiled(path: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(path))


def posed(model: mujoco.MjModel, q: Floats | tuple[float, ...], root: Floats | None = None) -> mujoco.MjData:
    """The model in a pose, shape (29,) [rad], its root at position and quaternion, shape (7,), contacts found."""
    data = mujoco.MjData(model)
    data.qpos[:7] = (*START_ROOT_POS, 1, 0, 0, 0) if root is None else root
    for joint, angle in zip(select(G1_29), q, strict=True):
        data.qpos[model.joint(joint.mjcf_name).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    return data


def touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[str, str]]:
    """Pairs of bodies in contact, the feet on the ground left out."""
    geoms = data.contact.geom[data.contact.dist <= 0]
    pairs = {tuple(sorted(model.body(model.geom_bodyid[geom]).name for geom in pair)) for pair in geoms}
    return {(a, b) for a, b in pairs if not (b == "world" and a.endswith("ankle_roll_link"))}


def held(q: Floats | tuple[float, ...]) -> JointTargets:
    return JointTargets(np.array(q), *gains(4.0, 0.2))
