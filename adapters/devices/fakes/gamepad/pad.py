"""A gamepad of SDL's own, "virtual" kind, whose controls follow a script.

    {"device": "gamepad", "steps": [
        {"at_s": 0.5, "set": {"left_stick_y": 1.0, "right_primary": 1}},    full forward, A pressed, from now on
        {"at_s": 1.0, "set": {"left_stick_y": 0.0, "right_primary": 0}},
        {"at_s": 2.0, "plugged": false}, {"at_s": 3.0, "plugged": true}]}

SDL asks the pad for its state whenever events are looked for, so what is seen depends on the clock alone. Only plugging
in and out has a thread, since SDL takes no pad away while it looks at it.
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
import time
from pathlib import Path
from typing import Any

import msgspec

from adapters.devices.fakes.script import Clock, Play, Script, Step
from adapters.devices.gamepad import names
from station.errors import did_you_mean
from station.operator.device import DeviceError

NAME = "Fake gamepad"

_GAME_CONTROLLER, _UNKNOWN = 1, 0
_LOOK_S = 0.005
_UPDATE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class PadStep(Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a gamepad may do.

    Attributes:
        set: Controls and what they show from now on: sticks -1..1, triggers 0..1, buttons 0 or 1.
        plugged: Whether it is plugged in from now on.
    """

    set: dict[str, float] = msgspec.field(default_factory=dict)
    plugged: bool | None = None

    def __post_init__(self) -> None:
        for control, value in self.set.items():
            if control not in names.CONTROLS:
                raise ValueError(f"no control {control!r}{did_you_mean(control, names.CONTROLS)}")
            if not -1.0 <= value <= 1.0:
                raise ValueError(f"{control} is {value:g}; expected -1 to 1")


class _Description(ctypes.Structure):
    """``SDL_VirtualJoystickDesc`` of SDL 2.24 and later."""

    _fields_ = (
        ("version", ctypes.c_uint16),
        ("type", ctypes.c_uint16),
        ("naxes", ctypes.c_uint16),
        ("nbuttons", ctypes.c_uint16),
        ("nhats", ctypes.c_uint16),
        ("vendor_id", ctypes.c_uint16),
        ("product_id", ctypes.c_uint16),
        ("padding", ctypes.c_uint16),
        ("button_mask", ctypes.c_uint32),
        ("axis_mask", ctypes.c_uint32),
        ("name", ctypes.c_char_p),
        ("userdata", ctypes.c_void_p),
        ("update", _UPDATE),
        ("others", ctypes.c_void_p * 5),
    )


def sdl_library() -> Any:
    """Return the SDL that pygame has loaded.

    Raises:
        DeviceError: it is not found.
    """
    for line in Path("/proc/self/maps").read_text().splitlines():
        path = line.split(maxsplit=5)[-1]
        if "libSDL2-2" in path:
            library = ctypes.CDLL(path)
            library.SDL_JoystickFromInstanceID.restype = ctypes.c_void_p
            library.SDL_JoystickSetVirtualAxis.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int16]
            library.SDL_JoystickSetVirtualButton.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_uint8]
            library.SDL_GetError.restype = ctypes.c_char_p
            return library
    raise DeviceError("the fake gamepad needs the SDL that pygame's wheel brings; it is not loaded")


class FakePad:
    """A gamepad that plays a script from `begin` on; SDL must have been started.

    Args:
        script: What it does.
        clock: Tells the time [s].
        name: What it calls itself.
        is_known: Whether SDL knows which control is which.
    """

    def __init__(
        self, script: Script[PadStep], clock: Clock = time.monotonic, *, name: str = NAME, is_known: bool = True
    ) -> None:
        self._sdl = sdl_library()
        self._play, self._plugging = Play(script, clock), Play(script, clock)
        self._state: dict[str, float] = {}
        self._update = _UPDATE(self._show)  # kept alive: SDL calls it
        self._description = _Description(
            version=1, type=_GAME_CONTROLLER if is_known else _UNKNOWN, naxes=len(names.AXES),
            nbuttons=len(names.BUTTONS), button_mask=(1 << len(names.BUTTONS)) - 1,
            axis_mask=(1 << len(names.AXES)) - 1, name=name.encode(), update=self._update,
        )  # fmt: skip
        self._id: int | None = None
        self._stop = threading.Event()
        self.plug()
        self._thread = threading.Thread(target=self._plug_by_script, name="fake-gamepad", daemon=True)
        self._thread.start()

    def begin(self, start_s: float = 0.0) -> None:
        """Start the script's clock, at a time of the script [s]; until then nobody touches the pad."""
        self._play.begin(start_s)

    def plug(self) -> None:
        """Plug it in; nothing where it is."""
        if self._id is None:
            index = self._sdl.SDL_JoystickAttachVirtualEx(ctypes.byref(self._description))
            if index < 0:
                raise DeviceError(f"SDL made no fake gamepad: {self._sdl.SDL_GetError().decode(errors='replace')}")
            self._id = self._sdl.SDL_JoystickGetDeviceInstanceID(index)

    def unplug(self) -> None:
        """Tear it out."""
        if self._id is not None:
            for index in range(self._sdl.SDL_NumJoysticks()):
                if self._sdl.SDL_JoystickGetDeviceInstanceID(index) == self._id:
                    self._sdl.SDL_JoystickDetachVirtual(index)
                    break
            self._id = None

    def close(self) -> None:
        """Take it away."""
        self._stop.set()
        self._thread.join()
        self.unplug()

    def _show(self, _userdata: int | None) -> None:
        """Bring the controls up to date; called by SDL."""
        joystick = self._sdl.SDL_JoystickFromInstanceID(self._id)
        if not joystick or not self._play.has_begun:  # SDL looks once when it opens a pad
            return
        for _, step in self._play.due(self._play.time_s()):
            self._state.update(step.set)
        for control, value in self._state.items():  # one that was never set is as SDL leaves it: never touched
            if control in names.AXES:
                self._sdl.SDL_JoystickSetVirtualAxis(joystick, names.AXES.index(control), _raw(control, value))
            else:
                self._sdl.SDL_JoystickSetVirtualButton(joystick, names.BUTTONS.index(control), int(value > 0.5))

    def _plug_by_script(self) -> None:
        while not self._stop.wait(_LOOK_S):
            if not self._play.has_begun:
                continue
            due = [step.plugged for _, step in self._plugging.due(self._play.time_s()) if step.plugged is not None]
            if due:  # begun midway, much is due at once; what counts is where it stands then
                with contextlib.suppress(DeviceError):
                    (self.plug if due[-1] else self.unplug)()


def _raw(control: str, value: float) -> int:
    """Return what a real pad's axis says: a trigger goes from one end to the other, a stick's y is turned round."""
    if control in names.TRIGGERS:
        value = 2.0 * value - 1.0
    elif control.endswith("_y"):
        value = -value
    return max(-names.FULL - 1, round(value * names.FULL))
