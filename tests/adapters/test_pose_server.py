"""motion_tracking's poses: what an answer is, when it counts, and the command that it becomes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from adapters.commands.root import CommandedRoot
from adapters.commands.twist2 import FORMAT
from adapters.motions.load import load
from adapters.pose_server import (
    ASK_S,
    UNANSWERED_S,
    BadPose,
    Pose,
    PosedRobot,
    Session,
    pack_buttons,
    pack_pose,
    parse_buttons,
    parse_pose,
    parse_question,
)
from station.rotations import from_roll_pitch_yaw, rotate_inverse

QPOS = np.array([0.1, 0.2, 0.8, 1.0, 0, 0, 0, *FORMAT.default[6:]])


def answer(qpos: np.ndarray = QPOS, *, start: object = False, **changed: object) -> bytes:
    """Return an answer as motion_tracking's server sends it, its two parts joined by a zero byte."""
    frames = np.atleast_2d(qpos).astype(np.float32)
    head = {"start": start, "num_frames": frames.shape[0], "qpos_size": frames.shape[1]} | changed
    return json.dumps(head).encode() + b"\0" + frames.tobytes()


def test_the_newest_frame_of_an_answer_counts() -> None:
    other = QPOS + np.array([*[0.0] * 35, 0.3])
    pose = parse_pose(answer(np.stack([QPOS, other]), start=True))
    assert pose.is_start
    assert pose.qpos == pytest.approx(other)


@pytest.mark.parametrize(
    "message",
    [
        b"", b"\0", b"[]\0", answer()[:-4], answer() + bytes(4), answer(num_frames=2), answer(num_frames=0),
        answer(num_frames=10**12), answer(qpos_size=7), answer(num_frames="1"), answer(start="yes"),
        answer(QPOS * np.nan), answer(QPOS * 0.0), answer()[: 10], b"[" * 60_000 + b"\0",
    ],
)  # fmt: skip
def test_an_answer_that_is_none_is_refused(message: bytes) -> None:
    with pytest.raises(BadPose):
        parse_pose(message)


def test_buttons_are_read_and_nothing_else_is() -> None:
    told = {"t_ms": 5, "controller_buttons": {"right_key_one": True, "left_key_one": 0, "left_axis": [0.1, 0.2]}}
    assert parse_buttons(json.dumps(told).encode()) == (True, False)
    for data in (b"", b"{}", b'{"controller_buttons": []}', b'{"controller_buttons": {"right_key_one": "no way"}}'):
        with pytest.raises(BadPose):
            parse_buttons(data)


def test_questions_begin_with_the_button_one_at_a_time_and_end_with_the_other() -> None:
    session = Session()
    assert session.ask(0.0) is None
    session.on_buttons(begins=True, ends=False)
    assert session.ask(0.1) is None, "a button that was held from before begins nothing"
    session.on_buttons(begins=False, ends=False)
    assert session.on_buttons(begins=True, ends=False) == "starting"
    assert session.ask(0.2) == b'{"start":true}'
    assert session.ask(0.2 + ASK_S) is None, "the answer is not there yet"
    assert session.ask(0.2 + UNANSWERED_S + 0.001) == b'{"start":true}'
    assert session.on_answer(is_start=False) == "it answers a question of before the beginning"
    assert session.on_answer(is_start=True) == ""
    assert session.on_answer(is_start=False) == "nothing was asked"
    assert session.ask(0.5) == b'{"start":false}'
    assert session.on_answer(is_start=False) == ""
    assert session.on_buttons(begins=True, ends=True) == "waiting"
    assert session.ask(1.0) is None
    assert session.on_answer(is_start=False) == "nobody has begun, or it came after the end"


@pytest.mark.parametrize("motion", ["walk-forward", "turn-left", "squat"])
def test_the_poses_of_a_motion_become_the_command_that_asks_for_it(motion: str) -> None:
    clip, robot = load(f"builtin:{motion}"), PosedRobot()
    asked, made = [], []
    for tick in range(int(clip.duration_s / ASK_S)):
        at = clip.at(tick * ASK_S)
        pose = parse_pose(answer(np.concatenate([at.root_pos, at.root_quat_wxyz, at.q])))
        made.append(robot.command(pose.qpos, tick * ASK_S))
        asked.append(FORMAT.encode(at, clip.joint_names))
    error = (np.array(made) - np.array(asked))[10:]
    assert np.abs(error[:, 6:]).max() < 1e-5, "joints"
    assert np.abs(error[:, 2:5]).max() < 1e-4, "height, roll, pitch"
    assert np.abs(error[:, 5]).max() < 0.1, "yaw rate, by difference of what is stored in 32 bits"
    assert np.sqrt((error[:, :2] ** 2).mean(axis=0)).max() < 0.1, "velocity"


def test_questions_are_read_and_whatever_else_comes_is_refused() -> None:
    assert [parse_question(data) for data in (b'{"start": true}', b'{"start": false, "more": 1}', b"{}")] == [
        True, False, False,
    ]  # fmt: skip
    for data in (b"", b"[]", b"1", b'{"start": "yes"}', b'{"start": tru', b"\xff" * 9, b"[" * 60_000):
        with pytest.raises(BadPose):
            parse_question(data)


@pytest.mark.parametrize("is_start", [True, False])
def test_what_we_answer_and_press_is_what_their_server_says(is_start: bool) -> None:
    head, numbers = pack_pose(Pose(is_start, QPOS))
    theirs_head, _, theirs_numbers = answer(QPOS, start=is_start).partition(b"\0")
    assert (json.loads(head), numbers) == (json.loads(theirs_head), theirs_numbers)
    told = json.loads(pack_buttons(is_start, not is_start, 1_700_000_000_123_456_789))
    buttons = {"right_key_one": is_start, "left_key_one": not is_start}
    assert told == {"t_ms": 1_700_000_000_123, "controller_buttons": buttons}


def answered(command: np.ndarray, root: CommandedRoot, dt_s: float) -> np.ndarray:
    """Return the pose that a robot of theirs gets for a command."""
    root.advance(command, dt_s)
    head, numbers = pack_pose(Pose(False, np.concatenate([root.position, root.quat_wxyz, command[6:]])))
    return parse_pose(head + b"\0" + numbers).qpos


@pytest.mark.parametrize("motion", ["walk-forward", "walk-left", "walk-arc", "turn-left", "squat", "bow"])
def test_a_command_there_and_back_is_the_same_and_its_root_goes_where_the_motion_went(motion: str) -> None:
    clip, root, robot = load(f"builtin:{motion}"), CommandedRoot(), PosedRobot()
    sent, back, went = [], [], []
    for tick in range(int(clip.duration_s / ASK_S)):
        at = clip.at(tick * ASK_S)
        sent.append(FORMAT.encode(at, clip.joint_names))
        qpos = answered(sent[-1], root, ASK_S)
        back.append(robot.command(qpos, tick * ASK_S))
        went.append(np.concatenate([qpos[:3] - at.root_pos, [abs(qpos[3:7] @ at.root_quat_wxyz)]]))
    error = (np.array(back) - np.array(sent))[10:]
    assert np.abs(error[:, 6:]).max() < 1e-6, "joints [rad]"
    assert np.abs(error[:, 2:5]).max() < 1e-6, "height [m], roll, pitch [rad]"
    assert np.abs(error[:, 5]).max() < 1e-3, "yaw rate [rad/s], by difference of what is stored in 32 bits"
    assert np.sqrt((error[:, :2] ** 2).mean(axis=0)).max() < 0.05, "velocity [m/s], which the receiver smooths"
    drift = np.array(went)
    assert np.abs(drift[:, :2] - drift[0, :2]).max() < 0.015, "place [m]"
    assert np.abs(drift[:, 2]).max() < 1e-6, "height [m]"
    assert (2 * np.arccos(np.minimum(drift[:, 3], 1.0))).max() < 0.015, "orientation [rad]"


def test_a_root_that_leans_and_is_lowered_stays_over_its_place() -> None:
    root, lean = CommandedRoot(), from_roll_pitch_yaw([0.2, 0.5, 0.0])
    down = rotate_inverse(lean, [0.0, 0.0, -0.3])
    for tick in range(50):
        command = FORMAT.default.copy()
        command[:6] = down[0], down[1], 0.8 - 0.3 * tick * ASK_S, 0.2, 0.5, 0.0
        root.advance(command, ASK_S)
        if tick == 0:
            began = root.position  # how it rose before its first command is not known
    assert root.position == pytest.approx([*began[:2], 0.8 - 0.3 * 49 * ASK_S], abs=1e-9)
