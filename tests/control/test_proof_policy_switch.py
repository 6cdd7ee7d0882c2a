"""A walking G1 is handed from policy to policy at random moments, and walks on."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from station import registry
from station.control.parted_path import samples_of
from station.control.rig import PolicyChoice, Rig, RigConfig, build
from station.motion.playback import Playback
from tests.figures import Figures

SWITCHES = 200
WALKS = ("walk-forward", "walk-fast", "walk-arc", "walk-left", "walk-back", "walk-diagonal", "march", "turn-left")
OTHERS = {
    "twist2": PolicyChoice(),
    "stiff": PolicyChoice(policy="tracker", policy_options={"wrist_gains": "training"}),
}


@pytest.mark.assets
@pytest.mark.timeout(900)
def test_a_walking_robot_does_not_fall_when_it_is_handed_over(proof: Figures) -> None:
    random, rig = Random(7), build(RigConfig(policies=OTHERS))
    asked, at_rest, handed_over = 0, [0.0], [0.0]
    while asked < SWITCHES:
        asked += _walk(rig, random, at_rest, handed_over)
    proof.figure("hand-overs of a walking G1 among three policies", asked)
    proof.figure("greatest step of a target during a hand-over", max(handed_over), "rad")
    proof.figure("greatest step of a target else", max(at_rest), "rad")
    assert max(handed_over) < 1.5 * max(at_rest), "targets do not jump more than those of one policy do"


def _walk(rig: Rig, random: Random, at_rest: list[float], handed_over: list[float]) -> int:
    """Walk a clip and hand over meanwhile; add how far a target moved in each step [rad]; return how often."""
    name = random.choice(WALKS)
    rig.policy.reset()
    rig.robot.reset()  # type: ignore[attr-defined]
    control = rig.control()
    assert control.policies is not None
    playback = Playback(registry.find("loader", "motion")(f"builtin:{name}"), rig.command_format, lead_s=rig.period_s)
    tick, asked, before, next_s = 0, 0, None, random.uniform(1.5, 3.0)
    while not playback.is_done:
        now_s = tick * rig.period_s
        if now_s >= next_s and not control.policies.is_switching:
            others = [each for each in control.policies.names if each != control.policies.driving]
            control.policies.switch(random.choice(others))
            asked, next_s = asked + 1, now_s + random.uniform(0.8, 2.0)
        frame = playback.step(rig.period_s if tick else 0.0)
        record = control.step(control.sense(), samples_of(rig.command_format, frame.command, now_s), now_s)
        assert record.fall is None, f"{name} at {now_s:.2f} s, {record.policy} drove: {record.fall}"
        if before is not None:
            step_rad = float(np.abs(record.sent.q - before).max())
            (handed_over if control.policies.is_switching else at_rest).append(step_rad)
        tick, before = tick + 1, record.sent.q
    return asked
