"""Ten thousand wild commands on each built-in policy, and motions that pass its envelope unchanged."""

from __future__ import annotations

import msgspec
import pytest

from station.control.rig import RigConfig, build
from station.rehearse import rehearse
from station.suite import clips, promise, run, trial
from station.suite.promise import FULL

EXTENT = msgspec.structs.replace(FULL, attacks=840)  # some twelve commands each
POLICIES = [("tracker", "g1-mujoco", 4), ("g1-walk", "g1-mujoco", 0), ("go2-walk", "go2-mujoco", 0)]
"""And how many streams may end in a fall: none is the goal, four of the tracker's did."""


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("policy", "robot", "may_fall"), POLICIES)
def test_whatever_is_commanded_it_stands(proof: None, policy: str, robot: str, may_fall: int) -> None:
    planned = run.plan([RigConfig(robot=robot, policy=policy)], extent=EXTENT, only=["envelope"])
    assert planned.runs == EXTENT.attacks
    found = [outcome for outcome in run.run(planned).policies[0].cases if outcome.falls]
    assert len(found) <= may_fall, [outcome.case for outcome in found]


@pytest.mark.assets
def test_every_motion_that_the_tracker_follows_passes_to_the_last_bit(proof: None) -> None:
    found, missing = clips.find()
    assert missing == []
    rig = build(RigConfig(policy="tracker"))
    for clip in found.durations_s:
        made: list[tuple[int, ...]] = []
        rehearse(
            trial._clip(clip), rig.policy, rig.robot, rig.command_format, envelopes=rig.envelopes,
            on_step=lambda _, record, made=made: made.append(record.decision.beyond),  # type: ignore[misc]
        )  # fmt: skip
        assert not any(made), clip
    assert set(promise.HELD_BACK) <= set(found.durations_s)
