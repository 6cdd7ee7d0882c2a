"""Policies of others over a real G1's network: from the gantry to a walk by velocities, on the twin."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.policies.default_pose import DefaultPosePolicy
from station import assets, registry
from station.bus import codec
from station.contract import names_of
from station.control.command_validator import CommandSample
from station.errors import ConfigError
from tests.adapters.robots.g1.dds.bench import PERIOD_S, Bench, bench
from tests.figures import Figures

ZOO = {
    "holosoma": "zoo:policies/holosoma_fastsac_g1_29dof.onnx",
    "deploy-yaml": "zoo:policies/unitree_rl_mjlab_g1/deploy.yaml",
    "falcon": "zoo:policies/falcon_g1_29dof.onnx",
    "g1-walk": "builtin:g1-walk.onnx",
}
REFUSED = {
    "playground-g1": (
        "zoo:policies/playground_g1_policy.onnx",
        "needs the velocity of the base, which this robot does not",
    ),
    "rlgym-g1": ("zoo:policies/rlgym_g1_motion.pt", "drives 12 joints, the robot has 29"),
    "asap": ("zoo:policies/asap_dec_loco_g1.onnx", "asked for a stiffness of 304 of waist_yaw; expected 0 to 300"),
}
"""What does not fit a real G1 with 29 joints, and what is said of it."""

FORWARD_M_S, SECONDS = 0.4, 10.0


@pytest.mark.assets
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ZOO)
def test_a_policy_that_walks_in_simulation_walks_over_the_wire(name: str, proof: Figures) -> None:
    file = assets.resolve(ZOO[name])
    policy = registry.find("policy", name)(file)
    with bench(policies={"default-pose": DefaultPosePolicy(file, of=name), name: policy}) as found:
        found.plug_in()
        found.stand(name)
        assert found.twin.body.falls == 0, "it stands"
        began = found.twin.body.qpos[:2].copy()
        _walk(found, SECONDS)
        went_m = float(np.linalg.norm(found.twin.body.qpos[:2] - began))
        assert [event for event in found.events if event[0] in ("robot-fault", "fall")] == []
        assert found.twin.body.falls == 0
        assert dict(found.twin.firmware.refused) == {}
        assert found.policies.driving == name
    proof.figure(
        f"{name} walks over a G1's wire, asked for {FORWARD_M_S:g} m/s", went_m / SECONDS, "m/s", limit="no fall"
    )
    assert went_m > 0.5 * FORWARD_M_S * SECONDS


@pytest.mark.assets
@pytest.mark.parametrize("name", REFUSED)
def test_a_policy_that_does_not_fit_is_refused_with_the_reason(name: str, proof: Figures) -> None:
    file, words = REFUSED[name]
    path = assets.resolve(file)
    policies = {"default-pose": DefaultPosePolicy(path, of=name), name: registry.find("policy", name)(path)}
    with bench(policies=policies) as found:
        try:
            found.plug_in()
        except ConfigError as error:
            why_not = str(error)
        else:
            found.release()
            assert found.control.arm(found.clock.monotonic_s()) == ""
            found.run(2.5)  # its stiffness grows for two seconds
            why_not = found.reason("robot-fault")
            assert not found.twin.body.held.kp.any()
    assert words in why_not
    proof.figure(f"{name} over a G1's wire", why_not, limit="refused")


def _walk(found: Bench, seconds: float) -> None:
    """Ask for a velocity forward, of the legs where they are a part."""
    (path, *others) = found.control.commanded.paths
    vector = path.command_format.default.copy()
    vector[names_of(path.command_format.elements).index("vx")] = FORWARD_M_S
    for _ in range(round(seconds / PERIOD_S)):
        sample = CommandSample(codec.json_vector(vector), found.clock.monotonic_s() + 0.01)
        found.command = (sample, *(None for _ in others)) if others else sample
        found.run(PERIOD_S)
