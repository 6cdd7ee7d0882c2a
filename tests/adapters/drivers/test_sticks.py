"""Sticks and keys, as stock TWIST2 reads them."""

from __future__ import annotations

import pytest

from adapters.drivers.sticks import DEAD_BAND, HEIGHT_RATE, Sticks
from adapters.retarget.walking import FASTEST, FASTEST_BACK, HIGHEST_M, LOWEST_M, VelocityCommand

TICK_S = 0.01


@pytest.mark.parametrize(
    ("controls", "velocity"),
    [
        ({"left_stick_y": 1.0}, (FASTEST[0], 0.0, 0.0)),
        ({"left_stick_y": -1.0}, (-FASTEST_BACK, 0.0, 0.0)),
        ({"left_stick_x": 1.0}, (0.0, -FASTEST[1], 0.0)),
        ({"right_stick_x": 1.0}, (0.0, 0.0, -FASTEST[2])),
        ({"key_w": 1.0, "key_a": 1.0}, (FASTEST[0], 0.0, FASTEST[2])),
        ({"key_w": 1.0, "key_s": 1.0}, (0.0, 0.0, 0.0)),
        ({"left_stick_y": DEAD_BAND, "left_stick_x": -DEAD_BAND}, (0.0, 0.0, 0.0)),
        ({"left_stick_y": (1.0 + DEAD_BAND) / 2}, (FASTEST[0] / 2, 0.0, 0.0)),
        ({}, (0.0, 0.0, 0.0)),
    ],
)
def test_forward_is_forward_and_right_is_right(
    controls: dict[str, float], velocity: tuple[float, float, float]
) -> None:
    wish = Sticks().wish(controls, TICK_S)
    assert (wish.velocity_x, wish.velocity_y, wish.yaw_rate) == pytest.approx(velocity)


def test_the_height_stays_where_it_was_left() -> None:
    sticks = Sticks()
    for _ in range(50):
        sticks.wish({"right_stick_y": -1.0}, TICK_S)
    assert sticks.rest() == VelocityCommand(height=sticks.height)
    assert sticks.height == pytest.approx(HIGHEST_M - 0.5 * HEIGHT_RATE)
    for _ in range(500):
        sticks.wish({"dpad_down": 1.0}, TICK_S)
    assert sticks.height == LOWEST_M
