"""A button means one thing, when it is meant; what would be ambiguous is refused in a line."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station import registry
from station.errors import BadFile, ConfigError
from station.operator.buttons import ACTIONS, BOUNCE_FRAMES, DRIVING, HOLD_S, Buttons, Pressed, button_map, load

TICK_S = 0.01
UP: dict[str, float] = {}


class Hands:
    """Fingers on a pair of controllers."""

    def __init__(self, device: str = "pico", changes: dict[str, Any] | None = None) -> None:
        self.buttons = Buttons(button_map(device, changes))
        self.buttons.step(UP, TICK_S)

    def press(self, *names: str, seconds: float = TICK_S) -> list[str]:
        """Press controls for a time; return what started, in order."""
        return self.feed([dict.fromkeys(names, 1.0)] * round(seconds / TICK_S))

    def release(self) -> list[str]:
        return self.feed([UP] * BOUNCE_FRAMES)

    def feed(self, frames: Iterable[dict[str, float]]) -> list[str]:
        return [action for frame in frames for action in sorted(self.buttons.step(frame, TICK_S).started)]


@pytest.mark.parametrize(
    ("control", "action"),
    [
        ("right_primary", "start_pause"),
        ("left_primary", "exit"),
        ("left_stick_click", "estop"),
        ("right_stick_click", "mode"),
    ],
)
def test_stock_buttons_act_at_once_and_once(control: str, action: str) -> None:
    hands = Hands()
    assert hands.press(control) == [action]
    assert hands.press(control, seconds=5.0) == []
    assert hands.release() == []
    assert hands.press(control) == [action]


@pytest.mark.parametrize(
    ("control", "short", "long"),
    [("left_secondary", "record", "discard"), ("right_secondary", "mark", "rerecord")],
)
def test_a_short_press_and_a_long_one_of_the_same_button_are_two_things(control: str, short: str, long: str) -> None:
    hands = Hands()
    assert hands.press(control, seconds=0.2) + hands.release() == [short]
    assert hands.press(control, seconds=HOLD_S - 0.1) + hands.release() == [short]
    assert hands.press(control, seconds=HOLD_S + 0.1) == [long]
    assert hands.press(control, seconds=3.0) + hands.release() == []


def test_a_take_can_be_kept_thrown_away_marked_and_begun_anew_from_the_controllers() -> None:
    for device in ("pico", "gamepad"):
        gestures = button_map(device).gestures
        assert all(gestures[action] for action in ("record", "discard", "mark", "rerecord"))
        assert {gesture.kind for action in ("discard", "rerecord") for gesture in gestures[action]} == {"hold"}


@pytest.mark.parametrize("device", ["pico", "gamepad", "keyboard"])
def test_nobody_arms_by_accident_and_one_press_disarms_at_once(device: str) -> None:
    gestures = button_map(device).gestures
    (arm,), (disarm,) = gestures["arm"], gestures["disarm"]
    hands = Hands(device)
    for control in arm.controls:
        assert "arm" not in hands.press(control, seconds=HOLD_S + 1.0) + hands.release()
    assert hands.press(*arm.controls, seconds=HOLD_S + 0.1) == ["arm"]
    hands.release()
    assert hands.press(*disarm.controls) == ["disarm"]


def test_what_was_down_before_anybody_looked_acts_only_after_a_release() -> None:
    buttons = Buttons(button_map("pico"))
    for _ in range(10):
        assert buttons.step({"right_primary": 1.0}, TICK_S) == Pressed()
    buttons.step(UP, TICK_S)
    assert buttons.step({"right_primary": 1.0}, TICK_S).started == {"start_pause"}


def test_what_is_held_through_a_gap_acts_only_after_a_release() -> None:
    hands = Hands(changes={"engage": "right_grip"})
    hands.press("right_grip")
    assert hands.buttons.step({"right_grip": 1.0}, TICK_S).held == {"engage"}
    assert hands.buttons.step(None, TICK_S) == Pressed()
    for _ in range(10):
        assert hands.buttons.step({"right_grip": 1.0}, TICK_S) == Pressed()


def test_a_button_that_was_about_to_act_does_not_when_the_device_falls_silent() -> None:
    hands = Hands()
    hands.press("left_secondary", seconds=0.2)
    assert hands.buttons.step(None, TICK_S) == Pressed()
    assert hands.feed([UP] * 10) == []


def test_a_bouncing_contact_is_one_press() -> None:
    hands = Hands()
    down, up = {"right_primary": 1.0}, UP
    assert hands.feed([down, up, down, up, up, down, down, up, down, up, up, up]) == ["start_pause"]


def test_an_analogue_control_between_pressed_and_released_stays_what_it_was() -> None:
    hands = Hands(changes={"engage": "right_grip"})
    held = [bool(hands.buttons.step({"right_grip": value}, TICK_S).held) for value in (0.3, 0.45, 0.6, 0.45, 0.42)]
    assert held == [False, False, True, True, True]


def test_a_chord_is_not_what_its_parts_are() -> None:
    hands = Hands("spacemouse")
    assert hands.press("button_0", seconds=0.05) == []
    assert hands.press("button_0", "button_1") == ["estop"]
    assert hands.press("button_1") + hands.release() == []
    assert hands.press("button_1") + hands.release() == ["record"]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), max_size=300))
def test_whatever_is_pressed_one_gesture_at_most_comes_of_one_press(frames: list[tuple[bool, bool, bool]]) -> None:
    names = ("left_secondary", "right_secondary", "right_primary")
    buttons = Buttons(button_map("pico"))
    started, pressed, was = 0, 0, (True, True, True)
    for frame in frames:
        controls = {name: float(value) for name, value in zip(names, frame, strict=True)}
        started += len(buttons.step(controls, 0.1).started)
        pressed += sum(now and not before for now, before in zip(frame, was, strict=True))
        was = frame
    assert started <= pressed


@pytest.mark.parametrize("device", registry.names("device"))
def test_the_defaults_of_every_device_are_without_conflict_and_have_a_table(device: str) -> None:
    table = button_map(device).table()
    assert [row[0] for row in table] == list(ACTIONS)
    assert all(meaning for _, _, meaning in table)


def test_the_table_shows_gestures_as_they_are_written() -> None:
    table = {action: gestures for action, gestures, _ in button_map("pico", {"engage": "right_grip"}).table()}
    assert table["discard"] == "hold left_secondary"
    assert table["engage"] == "right_grip"
    assert table["success"] == "-"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"recrod": "left_menu"}, "my.yaml: unknown action 'recrod' (did you mean 'record'?)"),
        (
            {"mark": "right_secondry"},
            "my.yaml: mark: a pico has no control 'right_secondry' (did you mean 'right_secon",
        ),
        ({"mark": "left_primary"}, "my.yaml: mark: 'left_primary' means exit (a default) already; bind one of them"),
        ({"mark": "right_menu", "exit": "right_menu"}, "my.yaml: mark: 'right_menu' means exit already"),
        ({"mark": "hold left_stick_click"}, "my.yaml: estop: 'left_stick_click' would act late"),
        ({"estop": "hold left_menu"}, "my.yaml: estop: 'hold left_menu' would act late"),
        ({"mark": 3}, "my.yaml: mark: expected a control, 'hold CONTROL', controls joined by '+'"),
        ({"mark": "left_menu right_menu"}, "my.yaml: mark: expected a control"),
        ({"mark": "left_menu+"}, "my.yaml: mark: expected a control"),
        ({"mark": "left_menu+left_menu"}, "my.yaml: mark: 'left_menu+left_menu' names a control twice"),
    ],
)
def test_what_would_be_ambiguous_is_refused_in_a_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        button_map("pico", changes, where="my.yaml")
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("device", "control", "message"),
    [
        ("gamepad", "left_grip", "a gamepad has no control 'left_grip'"),
        ("spacemouse", "left_menu", "a spacemouse has no control 'left_menu'; it has button_*"),
        ("keyboard", "key_spcae", "a keyboard has no control 'key_spcae' (did you mean 'key_space'?)"),
    ],
)
def test_a_control_that_a_device_does_not_have_is_refused(device: str, control: str, message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)):
        button_map(device, {"mark": control})


def test_a_spacemouse_may_have_many_buttons_and_a_device_that_names_none_has_any(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert button_map("spacemouse", {"mark": "button_14"}).gestures["mark"][0].controls == ("button_14",)
    gello = registry.find("device", "gello")
    monkeypatch.setattr(registry, "find", lambda *_: dataclasses.replace(gello, name="wheel", controls=()))
    assert button_map("wheel", {"mark": "horn"}).gestures["mark"][0].controls == ("horn",)


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "buttons.yaml"
    path.write_text("exit: [right_menu, hold left_primary]\nmark: none\nrecord: left_grip + left_secondary\n")
    rows = {action: gestures for action, gestures, _ in load("pico", path).table()}
    assert (rows["exit"], rows["mark"]) == ("right_menu, hold left_primary", "-")
    assert (rows["record"], rows["start_pause"]) == ("left_grip+left_secondary", "right_primary")


def test_a_file_that_is_not_there_or_says_nothing_of_the_kind_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match="no such file"):
        load("pico", tmp_path / "nothing.yaml")
    (tmp_path / "list.yaml").write_text("- exit\n")
    with pytest.raises(ConfigError, match=r"list\.yaml: expected a mapping"):
        load("pico", tmp_path / "list.yaml")


def test_of_those_that_share_a_pad_some_only_drive_and_stop() -> None:
    shared = button_map("gamepad").only(DRIVING)
    assert set(shared.gestures) == set(button_map("gamepad").gestures) & set(DRIVING)
    assert {"engage", "estop"} <= set(shared.gestures)
    assert not {"record", "mark", "discard", "arm", "disarm"} & set(shared.gestures)
