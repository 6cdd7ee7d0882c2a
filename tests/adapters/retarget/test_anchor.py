"""The operator's world in the robot's."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.retarget.anchor import Anchor
from adapters.retarget.human import standing
from tests.adapters.retarget.people import ADULT, moved

STILL = standing(ADULT)


def test_a_body_that_moves_as_people_do_stays_where_it_is() -> None:
    anchor = Anchor()
    for frame in range(50):
        body = moved(STILL, (0.02 * frame, 0.0, 0.0), 0.05 * frame)
        np.testing.assert_array_equal(anchor.step(body).positions, body.positions)
    assert anchor.jumps == 0


@pytest.mark.parametrize(
    ("shift", "turn"), [((0.4, 0.0, 0.0), 0.0), ((0.0, 0.0, 0.0), 1.0), ((3.0, -1.0, 0.5), 3.0), ((0, 0, 0.4), -2.0)]
)
def test_after_a_leap_the_body_goes_on_where_it_was(shift: tuple[float, float, float], turn: float) -> None:
    anchor = Anchor()
    anchor.step(moved(STILL, (1.0, 2.0, 0.0), 0.3))
    found = anchor.step(moved(moved(STILL, (1.0, 2.0, 0.0), 0.3), shift, turn))
    assert anchor.jumps == 1
    np.testing.assert_allclose(found.positions, moved(STILL, (1.0, 2.0, 0.0), 0.3).positions, atol=1e-9)
    # A step forward in the new world is a step forward as the body looks.
    ahead = moved(moved(moved(STILL, (0.1, 0.0, 0.0)), (1.0, 2.0, 0.0), 0.3), shift, turn)
    gone = anchor.step(ahead).positions[0] - found.positions[0]
    np.testing.assert_allclose(gone, [0.1 * np.cos(0.3), 0.1 * np.sin(0.3), 0.0], atol=1e-9)


def test_after_a_pause_any_place_is_the_old_one() -> None:
    anchor = Anchor()
    anchor.step(STILL)
    found = anchor.step(moved(STILL, (0.2, 0.0, 0.0)), moved=True)
    np.testing.assert_allclose(found.positions, STILL.positions, atol=1e-12)
    assert anchor.jumps == 1
