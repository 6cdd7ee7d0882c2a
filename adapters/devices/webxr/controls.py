"""What a page sends of a pair of controllers, under the station's names. Imports nothing heavy."""

from __future__ import annotations

OF_A_SIDE = ("trigger", "grip", "stick_x", "stick_y", "stick_click", "primary", "secondary")
"""In the order of a frame: those of WebXR's ``xr-standard`` mapping. A page gets no menu button."""

SENT = tuple(f"{side}_{name}" for side in ("left", "right") for name in OF_A_SIDE)
"""In the order of a frame."""

TOUCH_HOLD = "touch_hold"
"""Whether a finger is on the pad of a touch screen that drives while it is held, 0 or 1."""

PINCHES = ("left_pinch", "right_pinch")
"""How far thumb and index finger are closed, 0 to 1; of a hand that is tracked without a controller."""

CONTROLS = (*SENT, TOUCH_HOLD, *PINCHES)
