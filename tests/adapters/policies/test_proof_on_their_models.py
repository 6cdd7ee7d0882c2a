"""Policies of others walk on the models that they were verified on, as fast as there, in a bare loop of a few seconds.

The figures are of another loop than this one, written from the facts by other hands; equal within 0.05 m/s or rad/s.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from adapters.policies.deploy_yaml import DeployYamlPolicy
from adapters.policies.pilla_go2 import PillaGo2Policy
from adapters.policies.playground import PlaygroundG1Policy, PlaygroundGo1Policy
from adapters.policies.rl_gym import RlGymG1Policy, RlGymH1Policy, RlGymH12Policy
from adapters.robots.g1.joints import JOINTS
from station.protocols import Policy
from tests.figures import Figures

from .bare_loop import BareLoop

Velocity = tuple[float, float, float]

WITHIN = 0.05
SECONDS = 5.0
G1 = {"effort": np.array([joint.effort_nm for joint in JOINTS]), "height_m": 0.79}
G1_LEG, H1_LEG, H1_2_LEG = [88, 139, 88, 139, 50, 50], [200, 200, 200, 300, 40], [200, 200, 200, 300, 60, 40]

pytestmark = [pytest.mark.assets, pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")]
torch = pytest.mark.torch


class Case(NamedTuple):
    """A policy, its file, the model, and the velocities that were measured by the commanded ones."""

    policy: Callable[[Path], Policy]
    checkpoint: str
    model: str
    options: dict[str, Any]
    figures: dict[Velocity, Velocity]


CASES = {
    "rlgym-g1": Case(RlGymG1Policy, "rlgym_g1_motion.pt", "g1_12dof.xml",
        {"effort": np.array(G1_LEG * 2), "height_m": 0.793},
        {(0, 0, 0): (0.01, -0.01, -0.01), (0.5, 0, 0): (0.48, 0.0, -0.01), (0, 0, 0.8): (0.02, -0.02, 0.75)}),
    "rlgym-h1": Case(RlGymH1Policy, "rlgym_h1_motion.pt", "h1_10dof.xml",
        {"effort": np.array(H1_LEG * 2), "height_m": 1.05},
        {(0, 0, 0): (-0.08, 0.02, -0.02), (0.5, 0, 0): (0.43, 0.03, -0.01), (0, 0.3, 0): (-0.07, 0.21, -0.01)}),
    "rlgym-h1-2": Case(RlGymH12Policy, "rlgym_h1_2_motion.pt", "h1_2_12dof.xml",
        {"effort": np.array(H1_2_LEG * 2), "height_m": 1.05},
        {(0, 0, 0): (0.02, 0.02, 0.04), (0.5, 0, 0): (0.49, 0.0, 0.03), (0, 0.3, 0): (0.02, 0.24, 0.03)}),
    "pilla-go2": Case(PillaGo2Policy, "pilla_go2_policy.jit", "go2.xml",
        {"effort": np.array([23.7, 23.7, 35.55] * 4), "height_m": 0.42, "armature": 0.1},
        {(1, 0, 0): (1.01, 0.01, -0.01), (0, 0.4, 0): (0.01, 0.38, 0.02), (0, 0, 0.5): (0.03, 0.0, 0.49)}),
    "playground-go1": Case(PlaygroundGo1Policy, "playground_go1_policy.onnx", "go1_playground.xml",
        {"effort": 0.0, "height_m": 0.278, "physics_dt_s": 0.004, "has_servos": True},
        {(0, 0, 0): (0.0, 0.0, 0.0), (1, 0, 0): (1.02, 0.0, 0.0), (0, 0.5, 0): (0.0, 0.46, 0.0)}),
    "playground-g1": Case(PlaygroundG1Policy, "playground_g1_policy.onnx", "g1_playground.xml",
        {"effort": 0.0, "height_m": 0.755, "has_servos": True},
        {(0, 0, 0): (0.14, -0.02, 0.08), (0.6, 0, 0): (0.66, -0.06, 0.0), (0, 0.4, 0): (0.26, 0.13, 0.10)}),
    "deploy-yaml of unitree_rl_lab": Case(DeployYamlPolicy, "unitree_rl_lab_g1.yaml", "g1_29dof.xml", G1,
        {(0, 0, 0): (-0.01, 0.0, 0.0), (0.5, 0, 0): (0.56, 0.03, -0.04), (0.8, 0, 0): (0.82, 0.0, -0.03)}),
    "deploy-yaml of unitree_rl_mjlab": Case(DeployYamlPolicy, "unitree_rl_mjlab_g1/deploy.yaml", "g1_29dof.xml", G1,
        {(0, 0, 0): (0.0, 0.0, 0.0), (0.5, 0, 0): (0.44, 0.01, 0.01), (0.8, 0, 0): (0.79, 0.0, 0.0)}),
}  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=torch if case.checkpoint.endswith((".pt", ".jit")) else ())
        for name, case in CASES.items()
    ],
)
def test_it_walks_as_fast_as_in_the_loop_that_it_was_verified_in(name: str, assets: Path, proof: Figures) -> None:
    case = CASES[name]
    policy = case.policy(assets / "zoo/policies" / case.checkpoint)
    assert policy.spec.name == name.partition(" of ")[0]
    loop = BareLoop(policy, assets / "zoo/models" / case.model, **case.options)
    measured = loop.walk(list(case.figures), SECONDS)
    off = [np.abs(np.subtract(*pair)).max() for pair in zip(case.figures.values(), measured, strict=True)]
    assert max(off) <= WITHIN, dict(zip(case.figures, np.round(measured, 3).tolist(), strict=True))
    proof.figure(f"{name} on its own model: farthest from what was measured elsewhere", max(off), "m/s or rad/s",
                 limit=f"{WITHIN} m/s or rad/s")  # fmt: skip
