"""From controls to actions: which button means what, and when it was meant.

An action is bound to gestures: a ``press``, a ``hold`` of `HOLD_S`, of one control or of several at once (a chord)::

    record: left_secondary             # a press
    discard: hold left_secondary       # the same button, held: nobody throws a take away by accident
    estop: [left_stick_click, start+back]
    mark: none

A press acts at once. Where the same control is also held or part of a chord, it acts when it is released, because only
then is it known not to be the other gesture. A control is a number, pressed above a half. A device's kind
(`station.operator.device_kind.DeviceKind`) says which controls it has and what they ask for. Pure: no device, no clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Literal

from station import config, registry
from station.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from station.operator.device_kind import DeviceKind

HOLD_S = 1.2
"""A hold takes this long [s]: longer than any press that is one."""

PRESSED, RELEASED = 0.5, 0.4
"""A control above the first is pressed, one below the second released; between them it stays what it was."""

BOUNCE_FRAMES = 3
"""A release is believed once it has lasted so many ticks, so that a bouncing contact is one press."""

ACTIONS: dict[str, str] = {
    "engage": "drive the robot while held (dead-man)",
    "start_pause": "start or pause driving",
    "exit": "go back to the default pose and end teleoperation",
    "estop": "emergency stop, latched",
    "mode": "next mode of the driver: what the sticks or the twist move",
    "record": "start an episode, or stop and keep it",
    "mark": "mark this moment in the episode",
    "discard": "flag the episode as discarded",
    "rerecord": "discard the episode and start it anew",
    "success": "say that the episode succeeded",
    "policy": "have the robot's next policy take over",
    "arm": "let targets go to the robot, which grows stiff over two seconds",
    "disarm": "send the robot nothing more, at once",
}
"""What an operator may ask for beside moving."""

DRIVING = ("engage", "start_pause", "exit", "estop", "mode")
"""Those of them that are about the robot, or the part of it, that one drives, and the stop."""


@dataclass(frozen=True, slots=True)
class Gesture:
    """What is done with controls: pressed or held, alone or together."""

    kind: Literal["press", "hold"]
    controls: tuple[str, ...]

    def __str__(self) -> str:
        return ("hold " if self.kind == "hold" else "") + "+".join(self.controls)


@dataclass(frozen=True, slots=True)
class ButtonMap:
    """Gestures by action; an action without gestures cannot be asked for from this device."""

    device: str
    gestures: Mapping[str, tuple[Gesture, ...]]

    def only(self, actions: Sequence[str]) -> ButtonMap:
        """Return the map of some of its actions."""
        return ButtonMap(self.device, {name: made for name, made in self.gestures.items() if name in actions})

    def table(self) -> list[tuple[str, str, str]]:
        """Return what `station devices buttons` shows: action, gestures (- for none), meaning."""
        return [
            (action, ", ".join(str(gesture) for gesture in self.gestures.get(action, ())) or "-", meaning)
            for action, meaning in ACTIONS.items()
        ]

    @property
    def how_to_drive(self) -> str:
        """Which controls engage, for a status line."""
        holds = [f"hold {gesture}" for gesture in self.gestures.get("engage", ())]
        return " or ".join([*holds, *self._told("start_pause")]) + " to drive"

    @property
    def beside_driving(self) -> str:
        """Controls for mode, record, mark and exit, for a help line; "" for none."""
        return ", ".join(
            f"{' or '.join(map(str, self.gestures[action]))} {action}"
            for action in ("mode", "record", "mark", "exit")
            if self.gestures.get(action)
        )

    @property
    def how_to_arm(self) -> str:
        """Which controls arm, for a status line; "" for none."""
        return " or ".join(self._told("arm")) + " to arm" if self.gestures.get("arm") else ""

    def _told(self, action: str) -> list[str]:
        return [f"press {one}" if one.kind == "press" else str(one) for one in self.gestures.get(action, ())]


@dataclass(frozen=True, slots=True)
class Pressed:
    """What is asked for in a tick.

    Attributes:
        started: Actions whose gesture was completed in this tick.
        held: Actions whose controls are down.
    """

    started: frozenset[str] = frozenset()
    held: frozenset[str] = frozenset()


def button_map(device: str, changes: Mapping[str, Any] | None = None, *, where: str = "buttons") -> ButtonMap:
    """Return the map of a kind of device: what it brings, with changes over that.

    Args:
        device: Registered name of the kind.
        changes: Gestures by action, as in the file.
        where: What the user calls the place they stand in.

    Raises:
        ConfigError: an unknown action or control, a value of no such form, or one gesture for two actions.
        UnknownName: no such kind is registered.
    """
    kind: DeviceKind = registry.find("device", device)
    bound: dict[str, tuple[Gesture, ...]] = {}
    for action, value in kind.buttons.items():
        bound |= _bind(kind, action, value, f"buttons of {device}")
    for action, value in (changes or {}).items():
        bound |= _bind(kind, action, value, where)
    _refuse_conflicts(bound, changes or {}, where)
    return ButtonMap(device, bound)


def load(device: str, path: Any) -> ButtonMap:
    """Return the map of a device with the changes that a YAML file makes.

    Raises:
        BadFile, ConfigError: as `station.config.read_yaml` and `button_map`; the message names file and key.
    """
    return button_map(device, config.read_yaml(path), where=str(path))


def _bind(kind: DeviceKind, action: str, value: Any, where: str) -> dict[str, tuple[Gesture, ...]]:
    if action not in ACTIONS:
        listed = ", ".join(ACTIONS)
        raise ConfigError(f"{where}: unknown action {action!r}{did_you_mean(str(action), ACTIONS)}; known: {listed}")
    if value is None or value == "none":
        return {action: ()}
    texts = value if isinstance(value, list) else [value]
    return {action: tuple(_gesture(kind, text, f"{where}: {action}") for text in texts)}


def _gesture(kind: DeviceKind, text: Any, where: str) -> Gesture:
    form = "a control, 'hold CONTROL', controls joined by '+', a list of these, or none"
    words = text.split() if isinstance(text, str) else []
    is_hold = words[:1] == ["hold"]
    names = "".join(words[is_hold:]).split("+")
    if not all(names) or (len(words) > 1 + is_hold and "+" not in text):
        raise ConfigError(f"{where}: expected {form}, got {text!r}")
    if len(set(names)) < len(names):
        raise ConfigError(f"{where}: {text!r} names a control twice")
    for name in names:
        _check_control(kind, name, where)
    return Gesture("hold" if is_hold else "press", tuple(sorted(names)))


def _check_control(kind: DeviceKind, name: str, where: str) -> None:
    if kind.controls and not any(fnmatchcase(name, known) for known in kind.controls):
        hint = did_you_mean(name, kind.controls) or f"; it has {', '.join(kind.controls)}"
        raise ConfigError(f"{where}: a {kind.name} has no control {name!r}{hint}")


def _refuse_conflicts(bound: Mapping[str, Sequence[Gesture]], changes: Mapping[str, Any], where: str) -> None:
    """Refuse a gesture that means two things, and an emergency stop that would have to wait for a release."""
    owner: dict[Gesture, str] = {}
    for action in sorted(bound, key=lambda name: name in changes):
        for gesture in bound[action]:
            if gesture in owner:
                other = owner[gesture] + ("" if owner[gesture] in changes else " (a default)")
                raise ConfigError(
                    f"{where}: {action}: '{gesture}' means {other} already; bind one of them to something else"
                )
            owner[gesture] = action
    for gesture in bound.get("estop", ()):
        if gesture.kind == "hold" or _is_shared(gesture, list(owner)):
            raise ConfigError(f"{where}: estop: '{gesture}' would act late; give it a control that nothing else uses")


def _is_shared(gesture: Gesture, gestures: Sequence[Gesture]) -> bool:
    """Whether the controls of a press may become another gesture: a hold, or a larger chord."""
    mine = set(gesture.controls)
    return any(
        (other.kind == "hold" and mine == set(other.controls)) or mine < set(other.controls) for other in gestures
    )


@dataclass(slots=True)
class _Control:
    """A control: whether it is down, for how long [s], and for how many ticks its release has been seen."""

    is_down: bool = True  # what was down before anybody looked counts only once it was seen released
    was_up: bool = False
    down_s: float = 0.0
    up_ticks: int = 0
    is_used: bool = False  # a gesture was made with it since it went down

    def step(self, value: float, dt_s: float) -> None:
        self.up_ticks = self.up_ticks + 1 if value < RELEASED else 0
        if self.is_down:
            self.down_s += dt_s
            if self.up_ticks >= (BOUNCE_FRAMES if self.was_up else 1):
                self.is_down, self.was_up = False, True
        elif value > PRESSED:
            self.is_down, self.down_s, self.is_used = True, 0.0, False

    @property
    def is_pressed(self) -> bool:
        return self.is_down and self.was_up


class Buttons:
    """Tells gestures from controls, tick by tick.

    Args:
        bound: Which gesture means what.
    """

    def __init__(self, bound: ButtonMap) -> None:
        every = [gesture for gestures in bound.gestures.values() for gesture in gestures]
        self._late = {gesture for gesture in every if gesture.kind == "press" and _is_shared(gesture, every)}
        pairs = [(action, gesture) for action, gestures in bound.gestures.items() for gesture in gestures]
        self._pairs = sorted(pairs, key=lambda pair: -len(pair[1].controls))  # a chord before what is part of it
        self._names = sorted({name for gesture in every for name in gesture.controls})
        self._controls = {name: _Control() for name in self._names}

    def step(self, controls: Mapping[str, float] | None, dt_s: float) -> Pressed:
        """Read the controls; without them (silence, a gap) nothing is asked for, and all must be seen released."""
        if controls is None:
            self._controls = {name: _Control() for name in self._names}
            return Pressed()
        was_down = {name for name, control in self._controls.items() if control.is_pressed}
        for name, control in self._controls.items():
            control.step(controls.get(name, 0.0), dt_s)
        down = {name for name, control in self._controls.items() if control.is_pressed}
        started = {action for action, gesture in self._pairs if self._is_made(gesture, was_down, down)}
        held = {action for action, gesture in self._pairs if down.issuperset(gesture.controls)}
        return Pressed(frozenset(started), frozenset(held))

    def _is_made(self, gesture: Gesture, was_down: set[str], down: set[str]) -> bool:
        """Whether a gesture is completed in this tick; its controls are then used up until they are released."""
        controls = [self._controls[name] for name in gesture.controls]
        if any(control.is_used for control in controls):
            return False
        names = set(gesture.controls)
        if gesture.kind == "hold":
            is_made = names <= down and min(control.down_s for control in controls) >= HOLD_S
        elif gesture in self._late:
            is_made = names <= was_down and not names <= down
        else:
            is_made = names <= down and not names <= was_down
        for control in controls:
            control.is_used |= is_made
        return is_made
