"""What a page sends becomes a sample in our axes (X1's table), or is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.devices.fakes.webxr.wearer import frame_of, seen_by_a_browser
from adapters.devices.webxr.body import JOINTS as BODY
from adapters.devices.webxr.controls import CONTROLS, SENT, TOUCH_HOLD
from adapters.devices.webxr.frame import FRAME, PARTS, BadFrame, packed, parse, sample_of
from adapters.devices.webxr.kind import KIND
from adapters.retarget.calibration import from_height
from adapters.retarget.pipeline import BodyRetarget
from adapters.retarget.skeleton import skeleton_of
from station import registry
from station.bus.joints import SMPL_24
from station.operator.sample import OperatorSample, Pose

HALF = math.sqrt(0.5)
LEVEL = (0.0, 0.0, 0.0, 1.0)
# Looking along -z, 0.2 m to the right, 1.6 m up, 0.5 m ahead; turned a quarter to the left about y.
HEAD = (0.2, 1.6, -0.5, 0.0, HALF, 0.0, HALF)
EVERY = sum(PARTS[name] for name in ("head", "left", "right", "controls_left", "controls_right"))


def sample(**values: Any) -> OperatorSample:
    told: dict[str, Any] = {"parts": EVERY, "head": HEAD, "left": (0, 1, 0, *LEVEL), "right": (0, 1, 0, *LEVEL)}
    return sample_of(parse(packed(**{**told, **values})), 7, {})


def test_x1_poses_are_in_our_axes():
    found = sample(right=(0.1, 1.1, -0.4, HALF, 0.0, 0.0, HALF))  # pitched up by a quarter about x, to the right
    assert found.capture_ns == 7
    assert found.head is not None
    assert found.right is not None
    np.testing.assert_allclose(found.head.position, [0.5, -0.2, 1.6], atol=1e-6)
    np.testing.assert_allclose(found.head.quat_wxyz, [HALF, 0.0, 0.0, HALF], atol=1e-6)  # to the left about z
    np.testing.assert_allclose(found.right.position, [0.4, -0.1, 1.1], atol=1e-6)
    np.testing.assert_allclose(found.right.quat_wxyz, [HALF, 0.0, -HALF, 0.0], atol=1e-6)  # up about -y


def test_x1_controls_have_our_names_and_a_stick_forwards_is_positive():
    values = np.arange(1, 15) / 20.0
    found = sample(controls=[*values, 0.0]).controls
    assert set(found) == set(SENT)
    assert found["left_trigger"] == pytest.approx(0.05)
    assert (found["left_stick_x"], found["left_stick_y"]) == (pytest.approx(0.15), pytest.approx(-0.2))
    assert found["right_secondary"] == pytest.approx(0.7)


def test_of_a_side_without_a_controller_there_is_nothing():
    found = sample(parts=PARTS["head"] | PARTS["right"] | PARTS["controls_right"])
    assert found.left is None
    assert {name.partition("_")[0] for name in found.controls} == {"right"}


def test_sticks_of_a_touch_screen_are_slower_and_say_whether_they_are_held():
    parts = PARTS["controls_left"] | PARTS["controls_right"] | PARTS["touch"]
    frame = parse(packed(parts=parts, controls=[0, 0, 0, -1, 0, 0, 0, *[0] * 7, 1]))
    found = sample_of(frame, 0, {}, touch_scale=0.5).controls
    assert (found["left_stick_y"], found["touch_hold"]) == (0.5, 1.0)


def hand() -> np.ndarray:
    """A left hand's 25 joints along -z from the wrist, a centimetre each."""
    return np.array([(0.0, 1.0, -0.01 * joint, *LEVEL) for joint in range(25)])


def test_a_hand_gets_its_palm_and_that_is_where_the_side_is():
    found = sample(parts=EVERY | PARTS["hand_left"], hand_left=hand())
    rows = found.hands["left"]
    assert rows.shape == (26, 7)
    np.testing.assert_allclose(rows[0, :3], [0.105, 0.0, 1.0], atol=1e-6)  # between joints 10 and 11
    np.testing.assert_allclose(rows[1, :3], [0.0, 0.0, 1.0], atol=1e-6)
    assert found.left is not None
    np.testing.assert_array_equal(found.left.position, rows[0, :3])


@pytest.mark.parametrize(("apart_m", "pinch"), [(0.1, 0.0), (0.03, 0.5), (0.01, 1.0)])
def test_a_pinch_is_how_near_thumb_and_index_finger_are(apart_m, pinch):
    joints = hand()
    joints[9, :3] = joints[4, :3] + [apart_m, 0.0, 0.0]
    assert sample(parts=EVERY | PARTS["hand_left"], hand_left=joints).controls["left_pinch"] == pytest.approx(pinch)


def test_a_palm_that_was_told_is_where_the_side_is():
    turned = Pose(np.array([0.0, 0.0, -0.05]), np.array([HALF, 0.0, HALF, 0.0]))
    frame = parse(packed(parts=PARTS["left"], left=(0.0, 1.0, -0.3, 0.0, HALF, 0.0, HALF)))
    found = sample_of(frame, 0, {"left": turned}).left
    assert found is not None
    np.testing.assert_allclose(found.position, [0.3, 0.0, 0.95], atol=1e-6)
    np.testing.assert_allclose(found.quat_wxyz, [0.5, -0.5, 0.5, 0.5], atol=1e-6)


@pytest.mark.parametrize(("change", "words"), [
    ({"head": (math.nan, *HEAD[1:])}, "head: no number"),
    ({"head": (1e9, *HEAD[1:])}, "head: no number, or beyond 100 m"),
    ({"left": (0, 0, 0, 0, 0, 0, 0)}, "left: a quaternion is not of unit length"),
    ({"controls": [2.0] + [0.0] * 14}, "left_trigger: 2, expected -1 to 1"),
    ({"controls": [math.nan] + [0.0] * 14}, "left_trigger: nan"),
    ({"sent_ms": math.inf}, "its times are no numbers"),
])  # fmt: skip
def test_what_is_no_frame_is_refused(change, words):
    with pytest.raises(BadFrame, match=words):
        sample(**change)


@pytest.mark.parametrize("data", [b"", b"x" * FRAME.itemsize, packed()[:-1], packed() + b"x"])
def test_what_is_another_message_is_refused(data):
    with pytest.raises(BadFrame, match=r"bytes, expected|begins with"):
        parse(data)


def test_the_fake_sends_what_comes_back():
    turn = np.array([0.5, 0.5, -0.5, 0.5])
    given = OperatorSample(
        head=Pose(np.array([0.1, 0.2, 1.6]), turn), left=Pose(np.array([0.4, 0.3, 1.1]), turn),
        right=Pose(np.array([0.4, -0.3, 1.1]), turn), controls={**dict.fromkeys(SENT, 0.0), "left_stick_y": 0.5},
    )  # fmt: skip
    found = sample_of(parse(frame_of(given, 1.0, 2.0)), 0, {})
    for name in ("head", "left", "right"):
        here, there = getattr(given, name), getattr(found, name)
        np.testing.assert_allclose(there.position, here.position, atol=1e-6)
        np.testing.assert_allclose(there.quat_wxyz, here.quat_wxyz, atol=1e-6)
    assert found.controls == given.controls


def test_a_phone_that_is_itself_the_hand_has_no_head_and_closes_the_hand_all_the_way():
    held = {**dict.fromkeys((*SENT, TOUCH_HOLD), 0.0), TOUCH_HOLD: 1.0, "right_trigger": 1.0, "right_stick_x": 1.0}
    given = OperatorSample(right=Pose(np.array([0.4, -0.3, 1.1]), np.array([0.5, 0.5, -0.5, 0.5])), controls=held)
    found = sample_of(parse(frame_of(given, 1.0, 2.0)), 0, {}, 0.5)
    assert (found.head, found.left) == (None, None)
    assert found.right is not None
    assert given.right is not None
    np.testing.assert_allclose(found.right.position, given.right.position, atol=1e-6)
    assert found.controls == held | {"right_stick_x": 0.5}


def test_the_page_has_the_same_layout():
    text = Path("adapters/devices/webxr/page/frame.js").read_text()
    assert f"BYTES = {FRAME.itemsize};" in text
    for name in ("head", "left", "right", "controls", "hand_left", "hand_right", "body"):
        assert f"this.{name} = floats({FRAME.fields[name][1]}, " in text
    for name, bit in PARTS.items():
        assert f"{name}: {bit}" in text


@pytest.mark.parametrize("time_s", [0.0, 2.0, 3.5])
@pytest.mark.parametrize("motion", ["builtin:wave", "builtin:walk-forward"])
def test_a_body_is_made_of_places_and_moves_a_robot_as_the_person_does(motion, time_s):
    worn = skeleton_of(registry.find("loader", "motion")(motion).at(time_s), 1.75)
    frame = parse(packed(parts=PARTS["body"], body=seen_by_a_browser(worn)))
    found = sample_of(frame, 0, {}).body
    assert found is not None
    near = {name: np.linalg.norm(here - there) for name, here, there in
            zip(SMPL_24, found.positions, worn.positions, strict=True)}  # fmt: skip
    for name in ("left_hip", "right_knee", "left_ankle", "right_shoulder", "left_elbow", "right_wrist", "head"):
        assert near[name] < 1e-5, name
    asked = [BodyRetarget(from_height(1.75)).step(body, 1).q for body in (found, worn)]
    np.testing.assert_allclose(asked[0], asked[1], atol=0.03)  # a spine that is bent elsewhere, feet that are level
    assert float(np.abs(asked[0] - asked[1]).mean()) < 0.005


def test_a_body_that_is_no_number_is_refused():
    places = np.zeros((len(BODY), 3))
    places[3, 1] = math.nan
    with pytest.raises(BadFrame, match="body: no number"):
        sample_of(parse(packed(parts=PARTS["body"], body=places)), 0, {})


def test_the_page_has_the_same_joints_of_a_body():
    text = Path("adapters/devices/webxr/page/frame.js").read_text()
    names = [name.removeprefix("left-") for name in BODY if not name.startswith("right-")]
    assert ", ".join(f'"{name}"' for name in names[:3]) in text
    assert ", ".join(f'"{name}"' for name in names[3:]) in text


def test_its_buttons_are_of_its_controls():
    for gestures in KIND.buttons.values():
        for gesture in [gestures] if isinstance(gestures, str) else gestures:
            assert set(gesture.removeprefix("hold ").split("+")) <= set(CONTROLS)
