"""SONIC's streamed poses as TWIST2's command, and back: orientation and joints as they are, the root by its feet."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.motions.load import load
from adapters.robots.g1.joints import FROM_ISAAC, G1_29, TO_ISAAC
from adapters.sonic.message import BadMessage, pack, parse
from adapters.sonic.pose import FRAME_S, Frame, PosedMotion, StreamedPose, frame_of


def fields(frames: int = 1, **changes: np.ndarray) -> dict[str, np.ndarray]:
    quat = np.tile(np.array([1, 0, 0, 0], np.float32), (frames, 1))
    joints = np.tile(FORMAT.default[6:][TO_ISAAC].astype(np.float32), (frames, 1))
    return {
        "body_quat": quat, "frame_index": np.arange(frames, dtype=np.int64), "joint_pos": joints,
        "joint_vel": np.zeros_like(joints), **changes,
    }  # fmt: skip


def test_isaac_labs_order_is_level_by_level() -> None:
    assert [G1_29[index] for index in TO_ISAAC[:6]] == [
        "left_hip_pitch", "right_hip_pitch", "waist_yaw", "left_hip_roll", "right_hip_roll", "waist_roll",
    ]  # fmt: skip
    assert [G1_29[index] for index in TO_ISAAC[23:]] == [
        f"{side}_wrist_{axis}" for axis in ("roll", "pitch", "yaw") for side in ("left", "right")
    ], "23 to 28 are the wrists, as SONIC's page says"
    assert np.arange(29)[TO_ISAAC][FROM_ISAAC].tolist() == list(range(29))


@pytest.mark.parametrize("motion", ["walk-fast", "walk-left", "turn-left", "squat", "bow"])
def test_a_motion_there_and_back_keeps_its_pose_and_the_root_follows_from_the_feet(motion: str) -> None:
    clip, streamed, posed = load(f"builtin:{motion}"), StreamedPose(), PosedMotion()
    there, back = [], []
    for tick in range(int(clip.duration_s / FRAME_S)):
        command = FORMAT.encode(clip.at(tick * FRAME_S), clip.joint_names)
        there.append(command)
        back.append(posed.command(frame_of(parse("pose", streamed.pack(command, FRAME_S)))))
    sent, got = np.array(there)[10:], np.array(back)[10:]
    assert got[:, 6:] == pytest.approx(sent[:, 6:], abs=1e-6)
    assert got[:, 3:5] == pytest.approx(sent[:, 3:5], abs=1e-6)
    assert np.abs(got[:, 2] - sent[:, 2]).max() < 0.002, "height [m]"
    assert np.abs(got[:, 5] - sent[:, 5]).max() < 0.01, "yaw rate [rad/s]"
    assert np.abs(got[:, :2].mean(axis=0) - sent[:, :2].mean(axis=0)).max() < 0.04, "mean velocity [m/s]"
    assert np.sqrt(((got[:, :2] - sent[:, :2]) ** 2).mean(axis=0)).max() < 0.1, "velocity, step by step [m/s]"


def test_the_newest_frame_of_a_message_counts_and_the_first_body() -> None:
    joints = fields(3)["joint_pos"]
    joints[-1] += 0.25
    bodies = np.zeros((3, 2, 4), np.float32)
    bodies[:, 0, 0] = bodies[:, 1, 3] = 1.0
    frame = frame_of(parse("pose", pack("pose", 1, fields(3, joint_pos=joints, body_quat=bodies))))
    assert frame.index == 2
    assert frame.quat_wxyz.tolist() == [1, 0, 0, 0]
    assert frame.q == pytest.approx(FORMAT.default[6:] + 0.25, abs=1e-6)


@pytest.mark.parametrize(
    "changed",
    [
        {"frame_index": np.zeros(0, np.int64)},
        {"frame_index": np.zeros((1, 1), np.int64)},
        {"frame_index": np.zeros(1, np.float32)},
        {"frame_index": np.arange(65, dtype=np.int64)},
        {"body_quat": np.zeros((1, 4), np.float32)},
        {"body_quat": np.zeros((2, 4), np.float32)},
        {"joint_pos": np.zeros((1, 28), np.float32)},
        {"joint_vel": np.full((1, 29), np.nan, np.float32)},
    ],
)
def test_a_pose_that_is_none_is_refused(changed: dict[str, np.ndarray]) -> None:
    frame_of(parse("pose", pack("pose", 1, fields())))
    with pytest.raises(BadMessage):
        frame_of(parse("pose", pack("pose", 1, fields(**changed))))


def test_frames_that_are_missing_are_counted_and_a_jump_of_the_numbers_is_no_velocity() -> None:
    posed, quat, q = PosedMotion(), np.array([1.0, 0, 0, 0]), FORMAT.default[6:]
    turned = np.array([np.cos(0.1), 0, 0, np.sin(0.1)])
    posed.command(Frame(10, quat, q))
    assert posed.command(Frame(13, turned, q))[5] == pytest.approx(0.2 / 0.06)
    assert posed.missing == 2
    assert posed.command(Frame(3, quat, q))[5] == 0.0
    assert posed.command(Frame(300, turned, q))[5] == 0.0
    assert posed.missing == 2
