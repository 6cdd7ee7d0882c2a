"""The 3Dconnexion devices that are known by name, and what their buttons are called."""

from __future__ import annotations

from dataclasses import dataclass, field

MOTION_USAGE = (1, 8)
"""HID usage page and usage of what sends motion: generic desktop, multi-axis controller."""

VENDORS = (0x256F, 0x046D)
"""3Dconnexion, and Logitech for the older models."""

_TWO = {0: "left", 1: "right"}
_PRO = {
    0: "menu", 1: "fit", 2: "top", 4: "right", 5: "front", 8: "roll", 12: "1", 13: "2", 14: "3", 15: "4",
    22: "esc", 23: "alt", 24: "shift", 25: "ctrl", 26: "rotation",
}  # fmt: skip
_ENTERPRISE = {**_PRO, 10: "iso1", 16: "5", 17: "6", 18: "7", 19: "8", 20: "9", 21: "10", 26: "lock"}
_UNKNOWN = {bit: "" for bit in range(16)}


@dataclass(frozen=True)
class Model:
    """A kind of spacemouse.

    Attributes:
        name: As it is sold.
        buttons: What is printed on each button, by its bit in the report.
        in_one_report: Whether translation and rotation come in one report.
        is_receiver: Whether mice are paired with it; which of its interfaces then speaks depends on the mouse.
    """

    name: str
    buttons: dict[int, str] = field(default_factory=lambda: dict(_UNKNOWN))
    in_one_report: bool = False
    is_receiver: bool = False


MODELS: dict[tuple[int, int], Model] = {
    (0x256F, 0xC635): Model("SpaceMouse Compact", _TWO),
    (0x256F, 0xC641): Model("SpaceMouse USB", {}),
    (0x256F, 0xC62E): Model("SpaceMouse Wireless (cable)", _TWO, in_one_report=True),
    (0x256F, 0xC62F): Model("SpaceMouse Wireless (receiver)", _TWO, in_one_report=True, is_receiver=True),
    (0x256F, 0xC63A): Model("SpaceMouse Wireless (Bluetooth)", _TWO, in_one_report=True),
    (0x256F, 0xC632): Model("SpaceMouse Pro Wireless", _PRO, in_one_report=True),
    (0x256F, 0xC638): Model("SpaceMouse Pro Wireless (Bluetooth)", _PRO, in_one_report=True),
    (0x256F, 0xC633): Model("SpaceMouse Enterprise", _ENTERPRISE, in_one_report=True),
    (0x256F, 0xC652): Model("Universal Receiver", _PRO, in_one_report=True, is_receiver=True),
    (0x046D, 0xC62B): Model("SpaceMouse Pro", _PRO),
    (0x046D, 0xC626): Model("SpaceNavigator", _TWO),
    (0x046D, 0xC627): Model("SpaceExplorer"),
    (0x046D, 0xC625): Model("SpacePilot"),
    (0x046D, 0xC629): Model("SpacePilot Pro", _ENTERPRISE),
}


def model_of(vendor_id: int, product_id: int, usage: tuple[int, int]) -> Model | None:
    """Return the model of a HID interface; None for what is no spacemouse, such as a mouse of the same maker."""
    known = MODELS.get((vendor_id, product_id))
    if known is None and vendor_id in VENDORS and usage == MOTION_USAGE:
        return Model(f"unknown model {vendor_id:04x}:{product_id:04x}")
    return known
