"""SDL's gamepads through pygame, without a window."""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.operator.device import DeviceError

UDEV_RULE = 'KERNEL=="event*", ENV{ID_INPUT_JOYSTICK}=="1", MODE="0660", GROUP="input", TAG+="uaccess"'
UDEV_FILE = "/etc/udev/rules.d/70-gamepad.rules"

_SETTINGS = {
    "SDL_VIDEODRIVER": "dummy",  # events come without a window and without a display
    "SDL_AUDIODRIVER": "dummy",
    "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1",
    "SDL_NO_SIGNAL_HANDLERS": "1",  # SIGTERM is the server's to hear
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
}


@dataclass(frozen=True)
class Pad:
    """One gamepad that is plugged in.

    Attributes:
        index: SDL's number of it, until one is plugged in or out.
        name: As it calls itself.
        guid: SDL's name of its model, in hexadecimal digits.
        is_mapped: Whether SDL knows which control is which.
    """

    index: int
    name: str
    guid: str
    is_mapped: bool

    def __str__(self) -> str:
        return f"{self.index} {self.name!r} (guid {self.guid})"


def start(mapping: str = "") -> Any:
    """Start SDL's part for gamepads, once in a process; return pygame.

    Args:
        mapping: An SDL mapping for a pad that SDL does not know; heeded by the first call.

    Raises:
        DeviceError: pygame is not installed.
    """
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    if mapping:
        os.environ["SDL_GAMECONTROLLERCONFIG"] = mapping
    try:
        pygame = importlib.import_module("pygame")
        controller = importlib.import_module("pygame._sdl2.controller")
    except ImportError:
        raise DeviceError(
            "a gamepad needs pygame, which is not installed; pip install 'teleop-station[gamepad]'"
        ) from None
    pygame.display.init()
    pygame.joystick.init()
    controller.init()
    return pygame


def choose(pygame: Any, *, name: str = "", index: int | None = None) -> Pad:
    """Return the one gamepad that is plugged in, or the one of several that was asked for.

    Raises:
        DeviceError: there is none, none that fits, or more than one.
    """
    pygame.event.pump()  # SDL learns of a new pad here
    pads = _pads(pygame)
    if not pads:
        raise DeviceError(why_none())
    listed = ", ".join(map(str, pads))
    fitting = [pad for pad in pads if name.lower() in pad.name.lower() and index in (None, pad.index)]
    if not fitting:
        wanted = " and ".join(filter(None, [name and f"name {name!r}", "" if index is None else f"index {index}"]))
        raise DeviceError(f"no gamepad with {wanted}; found: {listed}")
    if len(fitting) > 1:
        raise DeviceError(f"{len(fitting)} gamepads found: {listed}; choose one with name: or index:")
    return fitting[0]


def plugged_in() -> list[str]:
    """Return each gamepad that is plugged in, as a person is told.

    Raises:
        DeviceError: there is no library.
    """
    pygame = start()
    pygame.event.pump()
    return [str(pad) for pad in _pads(pygame)]


def _pads(pygame: Any) -> list[Pad]:
    controller = importlib.import_module("pygame._sdl2.controller")
    pads = []
    for index in range(pygame.joystick.get_count()):
        try:
            joystick = pygame.joystick.Joystick(index)
            pads.append(Pad(index, joystick.get_name(), joystick.get_guid(), bool(controller.is_controller(index))))
        except pygame.error:
            continue  # it was torn out while we looked
    return pads


def why_none(inputs: Path = Path("/sys/class/input"), nodes: Path = Path("/dev/input")) -> str:
    """Return why SDL sees no gamepad: there is none, or the kernel has one that we may not read."""
    for joystick in sorted(inputs.glob("js*")):
        for event in sorted((joystick / "device").glob("event*")):
            node = nodes / event.name
            if node.exists() and not os.access(node, os.R_OK):
                return (
                    f"gamepad at {node}: permission denied; install this udev rule and plug it in again: "
                    f"echo '{UDEV_RULE}' | sudo tee {UDEV_FILE} && sudo udevadm control --reload"
                )
    return "no gamepad found; plug one in, or wake a wireless one"
