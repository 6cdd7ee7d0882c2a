"""``station settings``: what each server is, and what each of its settings means."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import pytest

from station import registry
from station.cli.settings import settings_of
from tests.cli.running import Home, one_line


class Inner(msgspec.Struct, frozen=True):
    """Within another.

    Attributes:
        gain: How much [1/s].
    """

    gain: float = 2.0


class Base(msgspec.Struct, kw_only=True):
    """What several have.

    Attributes:
        rate_hz: Looks per second [Hz]; None for
            the device's own.
        fate: What it is in the base.

    Raises:
        ValueError: never.
    """

    rate_hz: float | None = None
    fate: str = ""


class Config(Base, kw_only=True):
    """A configuration.

    Attributes:
        file, folder: Where it is.
        fate: What becomes of it: ``kept`` or ``gone``.
        inner: The other.
    """

    file: str
    folder: str = "."
    fate: Literal["kept", "gone"] = "kept"
    inner: Inner = Inner()
    options: dict[str, float] = {}
    policy: Annotated[str, registry.named("policy")] = ""


class Place(msgspec.Struct):
    """Where something is, all of it or nothing."""

    path: str


class Placed(msgspec.Struct, kw_only=True):
    """What may have a place."""

    place: Place | None = None
    options: dict[str, str] = {}


def test_what_may_be_left_out_as_a_whole_need_not_be_given_and_what_a_choice_needs_must() -> None:
    found = {setting.name: setting.required for setting in settings_of(Placed, {"options": Place})}
    assert found == {"place.path": False, "options.path": True}


def test_each_setting_has_the_words_of_its_docstring_its_default_and_its_choices() -> None:
    found = {setting.name: setting for setting in settings_of(Config, {"options.a": Inner})}
    assert list(found) == ["rate_hz", "fate", "file", "folder", "inner.gain", "options.a.gain", "policy"]
    assert (found["rate_hz"].about, found["rate_hz"].type) == (
        "Looks per second [Hz]; null for the device's own.",
        "number",
    )
    assert (found["fate"].about, found["fate"].choices) == (
        "What becomes of it: `kept` or `gone`.",
        ("kept", "gone"),
    )
    assert (found["file"].about, found["file"].required) == ("Where it is.", True)
    assert (found["folder"].about, found["folder"].required, found["folder"].default) == ("Where it is.", False, ".")
    assert (found["inner.gain"].about, found["inner.gain"].default) == ("How much [1/s].", 2.0)
    assert set(found["policy"].choices) == set(registry.names("policy"))


def test_no_setting_of_ours_is_without_words() -> None:
    types = {f"server {name}": registry.find("server", name).config for name in registry.names("server")}
    for kind in ("driver", "camera", "robot", "voice", "export"):
        types |= {f"{kind} {name}": registry.find(kind, name).options for name in registry.names(kind)}  # type: ignore[arg-type]
    silent = [f"{of}: {setting.name}" for of, each in types.items() for setting in settings_of(each)
              if not setting.about]  # fmt: skip
    assert silent == []


@pytest.mark.usefixtures("processes")
def test_the_options_shown_are_those_of_the_driver_that_is_set(home: Home) -> None:
    for words in (["settings", "teleop"], ["serve", "teleop", "--list-keys"]):
        said = home.run(*words, "--set", "driver=joints").stdout
        assert '\ndriver="hands"\n' in f"\n{said}"
        assert "\noptions.grippers=" in said
        assert "options.waist" not in said
    found = {row["name"]: row for row in home.json("settings", "camera", "--set", "source=zmq")}
    assert "options.address" in found
    assert found["width"]["about"].endswith("or as files or senders have it.")


@pytest.mark.usefixtures("processes")
def test_without_a_server_all_are_listed_and_a_wrong_setting_is_told(home: Home) -> None:
    listed = {row["name"]: row for row in home.json("settings")}
    assert set(listed) == set(registry.names("server"))
    assert listed["recorder"]["role"] == "recorder"
    assert "unknown server 'motin' (did you mean 'motion'?)" in one_line(home.run("settings", "motin"))
    assert "unknown driver 'hand'" in one_line(home.run("settings", "teleop", "--set", "driver=hand"))
