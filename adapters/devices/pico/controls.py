"""What a pair of Pico controllers has, under the station's names: the field of the app, and the call of the library."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["button", "trigger", "axis"]

RANGES: dict[Kind, tuple[float, float]] = {"button": (0.0, 1.0), "trigger": (0.0, 1.0), "axis": (-1.0, 1.0)}
"""Least and greatest value."""


@dataclass(frozen=True, slots=True)
class Control:
    """One control.

    Attributes:
        side: The controller it is on.
        field: Its name in the app's JSON.
        kind: What values it has.
        call: Name of the library's function.
        index: Element of what that returns; None where it returns the value itself.
    """

    side: Literal["left", "right"]
    field: str
    kind: Kind
    call: str
    index: int | None = None


CONTROLS: dict[str, Control] = {
    "left_trigger": Control("left", "trigger", "trigger", "get_left_trigger"),
    "left_grip": Control("left", "grip", "trigger", "get_left_grip"),
    "left_stick_x": Control("left", "axisX", "axis", "get_left_axis", 0),
    "left_stick_y": Control("left", "axisY", "axis", "get_left_axis", 1),
    "left_stick_click": Control("left", "axisClick", "button", "get_left_axis_click"),
    "left_primary": Control("left", "primaryButton", "button", "get_X_button"),
    "left_secondary": Control("left", "secondaryButton", "button", "get_Y_button"),
    "left_menu": Control("left", "menuButton", "button", "get_left_menu_button"),
    "right_trigger": Control("right", "trigger", "trigger", "get_right_trigger"),
    "right_grip": Control("right", "grip", "trigger", "get_right_grip"),
    "right_stick_x": Control("right", "axisX", "axis", "get_right_axis", 0),
    "right_stick_y": Control("right", "axisY", "axis", "get_right_axis", 1),
    "right_stick_click": Control("right", "axisClick", "button", "get_right_axis_click"),
    "right_primary": Control("right", "primaryButton", "button", "get_A_button"),
    "right_secondary": Control("right", "secondaryButton", "button", "get_B_button"),
    "right_menu": Control("right", "menuButton", "button", "get_right_menu_button"),
}
