"""What the buttons of a pair of controllers ask for, one in each hand: a headset's, or the two halves of a gamepad.

As in stock TWIST2: right A starts and pauses, left X exits, left Y records, the left stick stops, the right stick
changes the mode. What TWIST2 does not have is on the same two buttons: Y keeps an episode or, held, discards it; B
marks a moment or, held, records anew.

Arming needs everything squeezed for `station.operator.buttons.HOLD_S`: no hand does that by accident, and it opens and
closes the fingers at once, so it moves none. Disarming is one press of a button that nothing else uses.
"""

from __future__ import annotations

BUTTONS = {
    "start_pause": "right_primary",
    "exit": "left_primary",
    "record": "left_secondary",
    "discard": "hold left_secondary",
    "mark": "right_secondary",
    "rerecord": "hold right_secondary",
    "estop": "left_stick_click",
    "mode": "right_stick_click",
    "arm": "hold left_trigger+left_grip+right_trigger+right_grip",
    "disarm": "left_menu",
}
"""Gestures by action, see `station.operator.buttons`."""
