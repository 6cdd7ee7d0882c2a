"""An actor's bones as a body: they come back as the body that they were made of, whichever way they are streamed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from adapters.devices.fakes.natnet import person
from adapters.devices.natnet.actor import Actor, NotAPerson
from adapters.devices.natnet.wire import Skeleton
from adapters.retarget.calibration import from_lengths
from adapters.retarget.human import INDEX, of_height, standing
from adapters.retarget.pipeline import BodyRetarget
from adapters.retarget.skeleton import skeleton_of
from station import registry
from station.operator.sample import Body

LENGTHS = of_height(1.75)
FBX = {
    "Hip": "Hips", "Ab": "Spine", "Chest": "Spine1", "Shoulder": "Shoulder", "UArm": "Arm", "FArm": "ForeArm",
    "Hand": "Hand", "Thigh": "UpLeg", "Shin": "Leg", "Foot": "Foot", "Toe": "ToeBase",
}  # fmt: skip
BVH = {
    "Hip": "Hips", "Ab": "Chest", "Chest": "Chest2", "Shoulder": "Collar", "UArm": "Shoulder", "FArm": "Elbow",
    "Hand": "Wrist", "Thigh": "Hip", "Shin": "Knee", "Foot": "Ankle", "Toe": "Toe",
}  # fmt: skip


def walking(time_s: float) -> Body:
    return skeleton_of(registry.find("loader", "motion")("builtin:walk-arc").at(time_s), 1.75)


def bones(body: Body, *, is_local: bool = True):
    return person.seen(body.positions[None], body.quats_wxyz[None], is_local=is_local)[0]


def renamed(names: dict[str, str]) -> Skeleton:
    """Motive's other conventions, as its plug-in for Unity lists them."""
    made = person.described(LENGTHS)

    def name(old: str) -> str:
        bone = old.removeprefix("Ada_")
        if bone in names or bone in ("Neck", "Head"):
            return f"Ada_{names.get(bone, bone)}"
        return f"Ada_{'Left' if bone[0] == 'L' else 'Right'}{names[bone[1:]]}"

    return Skeleton(made.name, made.id, tuple(dataclasses.replace(bone, name=name(bone.name)) for bone in made.bones))


@pytest.mark.parametrize("is_local", [True, False])
@pytest.mark.parametrize(
    "skeleton", [person.described(LENGTHS), renamed(FBX), renamed(BVH)], ids=["motive", "fbx", "bvh"]
)
def test_the_robot_does_by_the_bones_what_it_does_by_the_body(skeleton: Skeleton, is_local: bool) -> None:
    actor, by_bones, by_body = Actor(skeleton), BodyRetarget(from_lengths(LENGTHS)), BodyRetarget(from_lengths(LENGTHS))
    for number in range(60):
        body, capture_ns = walking(number * 0.02), number * 20_000_000
        found = actor.body(bones(body, is_local=is_local))
        made, wanted = by_bones.step(found, capture_ns), by_body.step(body, capture_ns)
        np.testing.assert_allclose(made.q, wanted.q, atol=1e-4)
        np.testing.assert_allclose(made.root_pos, wanted.root_pos, atol=1e-4)
        np.testing.assert_allclose(made.root_lin_vel, wanted.root_lin_vel, atol=1e-3)


def test_motives_left_up_and_forward_are_ours() -> None:
    rows = bones(standing(LENGTHS), is_local=False)
    at = dict(zip([bone for bone, _, _ in person.BONES], rows["position"], strict=True))
    assert at["LHand"][0] > 0.5, "x is to the left"
    assert at["Head"][1] > 1.4, "y is up"
    assert at["LToe"][2] > at["LFoot"][2] + 0.1, "z is forward"
    body = Actor(person.described(LENGTHS)).body(rows)
    assert body is not None
    np.testing.assert_allclose(
        body.positions[INDEX["left_wrist"]], standing(LENGTHS).positions[INDEX["left_wrist"]], atol=1e-6
    )
    np.testing.assert_allclose(body.quats_wxyz, standing(LENGTHS).quats_wxyz, atol=1e-3)


def test_the_head_turns_by_its_own_bone() -> None:
    body = standing(LENGTHS)
    half = np.sqrt(0.5)
    body.quats_wxyz[INDEX["head"]] = [half, 0.0, 0.0, half]
    found = Actor(person.described(LENGTHS)).body(bones(body))
    assert found is not None
    np.testing.assert_allclose(found.quats_wxyz[INDEX["head"]], [half, 0.0, 0.0, half], atol=1e-6)
    np.testing.assert_allclose(found.quats_wxyz[INDEX["neck"]], [1.0, 0.0, 0.0, 0.0], atol=1e-6)


def test_one_bone_that_is_lost_or_lacks_makes_no_body() -> None:
    actor, rows = Actor(person.described(LENGTHS)), bones(standing(LENGTHS))
    assert actor.body(rows[::-1]) is not None, "in whatever order"
    assert actor.body(rows[:-1]) is None
    rows["flags"][3] = 0
    assert actor.body(rows) is None


def test_bones_of_other_lengths_and_orientations_of_none_are_refused() -> None:
    actor, rows = Actor(person.described(LENGTHS)), bones(standing(LENGTHS))
    long = rows.copy()
    long["position"] *= 1000.0
    with pytest.raises(NotAPerson, match=r"actor Ada: bones are not as long as described; is Motive's unit metres?"):
        actor.body(long)
    rows["quat_xyzw"][2] = 0.0
    with pytest.raises(NotAPerson, match="actor Ada: an orientation is not of unit length"):
        actor.body(rows)


def test_who_is_no_person_is_refused_in_a_line() -> None:
    made = person.described(LENGTHS)
    with pytest.raises(NotAPerson, match=r"actor Ada: no joint is the .* of a person; expected names as in"):
        Actor(Skeleton("Ada", 7, made.bones[:8]))
    lying = tuple(
        dataclasses.replace(bone, offset=(bone.offset[0], -bone.offset[2], bone.offset[1])) for bone in made.bones
    )
    with pytest.raises(NotAPerson, match="nobody stands along y in its description; set Up Axis to Y"):
        Actor(Skeleton("Ada", 7, lying))
    with pytest.raises(NotAPerson, match="bones are not described from the hips outwards, each once"):
        Actor(Skeleton("Ada", 7, made.bones[::-1]))
    torn = tuple(dataclasses.replace(bone, parent=0) if bone.name == "Ada_LShoulder" else bone for bone in made.bones)
    with pytest.raises(NotAPerson, match="no joint carries both shoulders; expected one tree"):
        Actor(Skeleton("Ada", 7, torn))
