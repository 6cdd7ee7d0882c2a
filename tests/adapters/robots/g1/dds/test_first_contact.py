"""The first contact with a robot, on its twin: is each joint the right one, what do motors do without commands."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.policies.default_pose import DefaultPosePolicy
from adapters.policies.joint_by_joint import JointByJointPolicy
from adapters.robots.g1.dds import rows
from adapters.robots.g1.dds.messages import TIMED_OUT
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.twin.faults import G1Faults
from station import assets
from station.bus import codec
from station.contract import names_of
from station.description import JOINT
from station.protocols import Floats
from station.supervision.figures import Bounds, Figure
from station.supervision.joint_response import bits, follows, let_go
from tests.adapters.robots.g1.dds.bench import PERIOD_S, Bench, bench

NAMES = [name.replace(JOINT, joint) for name in names_of(rows.SAMPLES) for joint in (G1_29 if JOINT in name else ("",))]


def columns(found: Floats, ending: str) -> Floats:
    return found[:, [NAMES.index(f"{joint}_{ending}") for joint in G1_29]]


def led(faults: G1Faults, joints: list[str]) -> dict[str, Figure]:
    """Lead some joints of a twin that hangs; return how each answered."""
    tracker = assets.resolve("builtin:tracker.onnx")
    policies = {
        "soft": DefaultPosePolicy(tracker, kp=20.0),
        "each": (each := JointByJointPolicy(tracker, kp=20.0, joint_s=1.2, joints=joints)),
    }
    with bench(faults, policies=policies) as found:
        found.plug_in()
        found.hang()
        found.run(3.0)
        found.policies.switch("each")
        found.run(1.0)
        before = len(found.records)
        found.run(each.sweep_s)
        assert not [event for event in found.events if event[0] == "robot-fault"]
        records = found.records[before:]
    asked, measured = (np.array([getattr(r, what).q for r in records]) for what in ("sent", "state"))
    answered = follows(np.arange(len(records)) * PERIOD_S, asked, measured, G1_29)
    return {figure.name: figure for figure in answered}


def test_r22_every_joint_of_a_robot_that_is_well_follows_alone() -> None:
    answered = led(G1Faults(), ["*"])
    assert list(answered) == list(G1_29)
    assert [figure for figure in answered.values() if not figure.is_good] == []


def test_r22_wires_that_are_swapped_and_a_joint_that_counts_the_wrong_way_are_named() -> None:
    faults = G1Faults(swapped_joints={"left_elbow": "right_elbow"}, reversed_joints=("left_knee",))
    answered = led(faults, ["*_elbow", "*_knee", "*_wrist_yaw"])
    wrong = {name: figure.text.split(":")[0] for name, figure in answered.items() if not figure.is_good}
    assert wrong == {
        "left_knee": "it moved the wrong way",
        "left_elbow": "right_elbow moved in its place",
        "right_elbow": "left_elbow moved in its place",
    }


def without_commands(found: Bench, seconds: float) -> tuple[Floats, Floats]:
    """Have no command reach a robot that hangs in its pose; return time since [s], shape (k,), and its samples."""
    found.change(commands_lost=True)
    times: list[Floats] = []
    samples: list[Floats] = []
    for step in range(round(seconds / PERIOD_S)):
        found.run(PERIOD_S)
        came = codec.parse_f64(found.robot.values()["samples"]).reshape(-1, len(NAMES))
        samples.append(came)
        times.append(np.full(len(came), step * PERIOD_S))
    return np.concatenate(times), np.concatenate(samples)


@pytest.mark.parametrize("does", ["hold", "damp", "limp"])
def test_r21_what_the_firmware_does_without_commands_is_told_from_torque_and_speed(does):
    with bench(G1Faults(without_commands=does, without_commands_after_s=1.5)) as found:
        found.plug_in()
        found.hang()
        found.run(3.0)
        found.robot.values()
        time_s, samples = without_commands(found, 6.0)
    torque, speed = columns(samples, "torque"), columns(samples, "vel")
    (motors,) = let_go(time_s, torque, speed, Bounds(least=1.3, most=1.7))
    assert motors.numbers["do"] == does
    words = bits(time_s, columns(samples, "error"), G1_29)
    if does == "hold":
        assert not motors.is_good, "it was expected to let go"
        assert words.text == "none"
        return
    assert motors.is_good, motors.text
    assert motors.numbers["damping"] == pytest.approx(8.0 if does == "damp" else 0.5, abs=0.3)
    assert list(words.numbers) == [f"{TIMED_OUT:#x}"]
    assert words.numbers[f"{TIMED_OUT:#x}"] == pytest.approx(1.5, abs=0.1)


def test_a_robot_that_bears_nothing_tells_nothing() -> None:
    still = np.zeros((100, 29))
    (motors,) = let_go(np.linspace(0.0, 5.0, 100), still, still)
    assert not motors.is_good
    assert motors.text.startswith("cannot be told")
