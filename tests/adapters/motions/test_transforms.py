"""Motions made of other motions."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.motions import builtin
from adapters.motions.clip import Clip
from adapters.motions.load import load
from adapters.motions.transforms import mirrored, retimed
from adapters.robots.g1 import kinematics
from station import rotations
from station.errors import UsageError
from station.protocols import Motion, Reference
from tests.adapters.motions.made import smooth

PARTS = ("root_pos", "root_quat_wxyz", "root_lin_vel", "root_ang_vel", "q")


def crooked() -> Clip:
    """A walk that turns, with every joint moving on its own."""
    motion = smooth()
    motion.q[:] = 0.3 * np.sin(2.0 * np.arange(len(motion))[:, None] / motion.fps + np.arange(29)) + 0.01 * np.arange(
        29
    )
    lean = rotations.from_rotation_vector(np.array([0.1, -0.2, 0.0]))
    motion.root_quat_wxyz[:] = rotations.multiply(motion.root_quat_wxyz, lean)
    return Clip(motion, facts={"clips": [{"name": "one", "start_s": 0.0, "end_s": 2.0}], "duration_s": 89 / 30})


def instants(motion: Motion) -> np.ndarray:
    return np.linspace(0.0, motion.duration_s, 23)


def assert_same(one: Reference, other: Reference) -> None:
    for part in PARTS:
        np.testing.assert_allclose(getattr(one, part), getattr(other, part), atol=1e-12)


def links_at(motion: Motion, time_s: float) -> kinematics.LinkPoses:
    seen = motion.at(time_s)
    return kinematics.forward(seen.root_pos[None], seen.root_quat_wxyz[None], seen.q[None])


def test_mirroring_twice_changes_nothing() -> None:
    motion = crooked()
    twice = mirrored(mirrored(motion))
    for time_s in instants(motion):
        assert_same(twice.at(time_s), motion.at(time_s))
    assert twice.facts()["mirrored"] is False


def test_in_the_mirror_every_link_is_where_the_other_side_was() -> None:
    motion = crooked()
    other = {"left": "right", "right": "left"}
    for time_s in instants(motion):
        seen, image = links_at(motion, time_s), links_at(mirrored(motion), time_s)
        for link in kinematics.LINKS:
            side, _, rest = link.name.partition("_")
            like = f"{other[side]}_{rest}" if side in other else link.name
            expected = seen.position[kinematics.INDEX[like], 0] * (1.0, -1.0, 1.0)
            # The two sides of the table differ by some hundredths of a millimetre and of a degree.
            np.testing.assert_allclose(image.position[kinematics.INDEX[link.name], 0], expected, atol=3e-4)


@pytest.mark.parametrize("make", [mirrored, lambda motion: retimed(motion, 1.6), lambda motion: retimed(motion, 0.5)])
def test_velocities_are_those_of_the_changed_positions(make) -> None:  # type: ignore[no-untyped-def]
    motion = make(crooked())
    step_s = 1.0 / motion.fps  # of the frames, whose differences a clip's velocities are
    for frame in range(5, 80, 9):
        time_s = frame * step_s
        before, now, after = (motion.at(time_s + offset) for offset in (-step_s, 0.0, step_s))
        moved = (after.root_pos - before.root_pos) / (2 * step_s)
        turned = rotations.multiply(after.root_quat_wxyz, rotations.inverse(before.root_quat_wxyz))
        turn_rate = rotations.rotation_vector(turned) / (2 * step_s)
        np.testing.assert_allclose(rotations.rotate(now.root_quat_wxyz, now.root_lin_vel), moved, atol=1e-9)
        np.testing.assert_allclose(rotations.rotate(now.root_quat_wxyz, now.root_ang_vel), turn_rate, atol=1e-9)


def test_a_retimed_motion_is_in_the_same_places_at_other_times() -> None:
    motion = crooked()
    fast = retimed(motion, 2.0)
    assert (fast.duration_s, fast.fps) == (motion.duration_s / 2.0, motion.fps * 2.0)
    for time_s in instants(fast):
        np.testing.assert_array_equal(fast.at(time_s).q, motion.at(2.0 * time_s).q)
        np.testing.assert_allclose(fast.at(time_s).root_lin_vel, 2.0 * motion.at(2.0 * time_s).root_lin_vel)
    facts = fast.facts()
    assert facts["clips"] == [{"name": "one", "start_s": 0.0, "end_s": 1.0}]
    assert (facts["speed"], facts["duration_s"]) == (2.0, fast.duration_s)
    assert_same(retimed(fast, 0.5).at(1.1), motion.at(1.1))
    assert retimed(fast, 0.5).facts()["speed"] == 1.0


@pytest.mark.parametrize("speed", [0.0, -1.0, 11.0, float("nan")])
def test_a_speed_that_cannot_be_is_refused(speed: float) -> None:
    with pytest.raises(UsageError, match=r"expected a number from 0\.1 to 10"):
        retimed(crooked(), speed)


def test_reaching_left_is_reaching_right_in_the_mirror() -> None:
    left, right = (Clip(builtin.make(f"builtin:reach-{side}")) for side in ("left", "right"))
    for time_s in instants(left):
        np.testing.assert_allclose(mirrored(left).at(time_s).q, right.at(time_s).q, atol=2e-3)


def test_a_reference_may_say_what_is_done_to_its_motion() -> None:
    plain, changed = load("builtin:walk-left"), load("builtin:walk-left#mirror#speed=1.25")
    assert changed.duration_s == pytest.approx(plain.duration_s / 1.25)
    assert changed.at(changed.duration_s).root_pos[1] == pytest.approx(-plain.at(plain.duration_s).root_pos[1])
    facts = changed.facts()
    assert (facts["mirrored"], facts["speed"]) == (True, 1.25)
    assert facts["sha256"] == plain.facts()["sha256"]
    assert changed.name.endswith("walk-left#mirror#speed=1.25")


@pytest.mark.parametrize("speed", ["fast", "0", "nan", "100"])
def test_a_reference_with_a_speed_that_cannot_be_is_refused(speed: str) -> None:
    with pytest.raises(UsageError, match=r"speed is .*expected a number"):
        load(f"builtin:wave#speed={speed}")
