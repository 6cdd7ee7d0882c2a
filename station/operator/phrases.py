"""What an operator is told of an event: one table from an event's name to words, which a lab may change.

operator-refused: no, {reason}                      # words, with the event's numbers in braces
disk-low: {words: "{minutes_left} minutes of disk left", tune: lost, urgent: true}
operator-mode: none                                 # not told
gate to=holding: the robot waits                    # only where the event says so
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from station import config as configs
from station.errors import ConfigError
from station.life.events import Event
from station.operator.voice import Cue, Tune

LONGEST_WORDS = 16
"""Nobody listens to more while driving."""

_FIELD = re.compile(r"\{(\w+)\}")
_NOT_SPOKEN = re.compile(r"[^\w\s.,:!?%°'()/+-]")  # no brackets, no tags: speech programs take those for orders
_MOST_PHRASES = 500
_SILENT = "none"


class Phrase(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is told of an event.

    Attributes:
        words: With fields of the event in braces; ``{take}`` is the number of the episode, ``{source}`` the server that
            says so. "" is not told.
        tune: What it sounds like to a voice without words.
        urgent: Whether it breaks off what is being said.
        about: Its subject; a newer phrase about the same takes the place of one that waits.
    """

    words: str
    tune: Tune = "note"
    urgent: bool = False
    about: str = ""


def _urgent(words: str, tune: Tune, about: str) -> Phrase:
    return Phrase(words=words, tune=tune, urgent=True, about=about)


def _said(words: str, tune: Tune = "note", about: str = "") -> Phrase:
    return Phrase(words=words, tune=tune, about=about)


DEFAULTS: dict[str, Phrase] = {
    # who drives
    "operator-engaged": _said("engaged", "up", "driving"),
    "operator-disengaged": _urgent("let go: {reason}", "lost", "driving"),
    "operator-disengaged reason=released": _said("released", "down", "driving"),
    "operator-disengaged reason=teleoperation is ending": _said("released", "down", "driving"),
    "operator-refused": _said("refused: {reason}", "no", "driving"),
    "operator-mode": _said("{mode}", "note", "mode"),
    "operator-exit": _said("leaving", "down", "driving"),
    "teleop-commands-end": _said("commands end: {reason}", "down", "commands"),
    # the device
    "operator-live": _said("{device} is there", "up", "device"),
    "operator-lost": _urgent("{device} lost", "lost", "device"),
    "operator-lost new=0": _said("waiting for {device}", "note", "device"),  # it has not been there yet
    # stops, and the robot
    "estop": _urgent("emergency stop", "alarm", "stop"),
    "operator-stop-failed": _urgent("the stop was not taken", "alarm", "stop"),
    "operator-reset": _said("stop released", "up", "stop"),
    "fall": _urgent("the robot fell", "alarm", "fall"),
    "robot-fault": _urgent("the robot is damped: {reason}", "alarm", "fall"),
    "robot-has-to-stand": _urgent("the robot has to stand: {reason}", "lost", "gate"),
    "policy-switched": _said("{policy} drives", "note", "policy"),
    "policy-switch-refused": _said("policy not switched: {reason}", "no", "policy"),
    "bad-action": _urgent("the policy gives no numbers", "alarm", "policy"),
    "controller-fault": _urgent("the controller stopped: {reason}", "alarm", "controller"),
    "controller-cleared": _said("the controller is clear", "up", "controller"),
    "request-refused": _said("not done: {reason}", "no", "controller"),
    "clear-refused": _said("not cleared: {reason}", "no", "controller"),
    "engage-refused": _said("refused: {reason}", "no", "driving"),
    "engagement-lost": _urgent("{reason}", "lost", "driving"),
    "target-refused": _said("targets are refused: {reason}", "no", "commands"),
    "arming": _said("arming", "note", "arming"),
    "armed": _said("armed", "up", "arming"),
    "disarmed": _said("disarmed", "down", "arming"),
    "arm-refused": _said("not armed: {reason}", "no", "arming"),
    "gate to=holding": _urgent("the robot holds: {reason}", "lost", "gate"),
    "gate to=returning": _said("the robot returns to standing", "down", "gate"),
    "refused-command": _said("commands are refused: {reason}", "no", "commands"),
    # the recording
    "record-start": _said("recording take {take}", "begin", "recording"),
    "record-stop": _said("take {take} saved", "end", "recording"),
    "record-stop discarded=true": _said("take {take} discarded", "no", "recording"),
    "record-discard": _said("take {take} discarded", "no", "recording"),
    "record-refused": _said("recorder: {reason}", "no", "recorder"),
    "operator-record-refused": _said("recorder: {reason}", "no", "recorder"),
    "record-failed": _urgent("the recording failed", "lost", "recording"),
    "recorder-resumed": _said("the recording goes on", "begin", "recording"),
    "tap-hole": _said("the recording has a hole", "lost", "recording"),
    "mark": _said("marked"),
    "mark label=success": _said("success", "up"),
    "disk-low": _said("disk low, {minutes_left} minutes left", "lost", "disk"),
    "disk-full": _urgent("the disk is full, the recording ended", "lost", "disk"),
    "disk-stuck": _said("the disk hangs", "lost", "disk"),
    "disk-ok": _said("the disk has room again", "note", "disk"),
    # the station
    "server-died": _urgent("{server} died", "lost", "server {server}"),
    "server-failed": _urgent("{source} died", "lost", "server {source}"),
    "server-crashed": _urgent("{source} died", "lost", "server {source}"),
    "server-given-up": _urgent("{server} died", "lost", "server {server}"),
    "server-silent": _urgent("{server} is silent", "lost", "server {server}"),
    "server-restarted": _said("{server} starts again", "note", "server {server}"),
    "server-back": _said("{server} is back", "up", "server {server}"),
    "server-active": _said("{server} is back", "up", "server {server}"),
    "bus-lost": _urgent("the bus is gone", "lost", "bus"),
    "bus-back": _said("the bus is back", "up", "bus"),
}
"""By event; a field after the name makes a phrase of its own for that value."""


class Phrases:
    """A table from events to cues.

    Args:
        changes: Phrases in place of, or beside, `DEFAULTS`.
    """

    def __init__(self, changes: Mapping[str, Phrase] | None = None) -> None:
        self.table = {**DEFAULTS, **(changes or {})}
        self._particular: dict[str, list[tuple[str, str, Phrase]]] = {}
        for key, phrase in self.table.items():
            name, _, condition = key.partition(" ")
            if condition:
                field, _, value = condition.partition("=")
                self._particular.setdefault(name, []).append((field, value, phrase))

    def cue(self, event: Event) -> Cue | None:
        """Return what is told of an event; None for nothing."""
        values = {"source": event.source, **event.detail}
        if (episode := values.get("episode_id")) is not None:
            values["take"] = _number_of(str(episode))
        phrase = self._phrase(event.name, values)
        if phrase is None or not (words := _filled(phrase.words, values)):
            return None
        about = _filled(phrase.about, values)
        return Cue(words=words, tune=phrase.tune, is_urgent=phrase.urgent, about=about)

    def _phrase(self, name: str, values: Mapping[str, Any]) -> Phrase | None:
        for field, value, phrase in self._particular.get(name, ()):
            if field in values and _as_text(values[field]) == value:
                return phrase
        return self.table.get(name)


def load(path: Path) -> Phrases:
    """Read a lab's changes to the table.

    Raises:
        BadFile: the file cannot be read.
        ConfigError: it is no table of phrases; the message names the event and the field.
    """
    return Phrases(parse(configs.read_yaml(path), where=str(path)))


def parse(values: Mapping[str, Any], *, where: str) -> dict[str, Phrase]:
    """Return phrases of plain values; raises `ConfigError` like `load`.

    What is given as words alone keeps tune, urgency and subject of the default.
    """
    if len(values) > _MOST_PHRASES:
        raise ConfigError(f"{where}: {len(values)} phrases, expected at most {_MOST_PHRASES}")
    return {str(key): _read(str(key), given, where) for key, given in values.items()}


def _read(key: str, given: Any, where: str) -> Phrase:
    name, _, condition = key.partition(" ")
    if not name or (condition and not re.fullmatch(r"\w+=.+", condition)):
        raise ConfigError(f"{where}: {key!r}: expected the name of an event, or name field=value")
    known = DEFAULTS.get(key) or DEFAULTS.get(name) or Phrase(words="")
    if given is None or given == _SILENT:
        return Phrase(words="")
    if isinstance(given, str):
        return msgspec.structs.replace(known, words=given)
    if not isinstance(given, dict):
        raise ConfigError(f"{where}: {key}: expected words, a mapping or none, got {given!r}")
    return configs.build(Phrase, {**msgspec.structs.asdict(known), **given}, where=f"{where}: {key}")


def _filled(text: str, values: Mapping[str, Any]) -> str:
    """Return a phrase with its fields, cut to what can be listened to and safe for any program."""
    filled = _FIELD.sub(lambda found: _spoken(values.get(found[1])), text)
    words = _NOT_SPOKEN.sub(" ", filled.replace("_", " ")).split()[:LONGEST_WORDS]
    return " ".join(words).lstrip(" :,-").rstrip(" :,")  # what begins with a dash would be an option


def _spoken(value: Any) -> str:
    """Return a value of an event in words: of a reason only what comes before its first semicolon."""
    if value is None or isinstance(value, (dict, list)):
        return ""
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 10 else f"{value:.1f}"
    return str(value).split(";")[0][:200]


def _as_text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _number_of(episode_id: str) -> str:
    """Return the number at the end of an episode's name, or the name."""
    found = re.search(r"(\d+)$", episode_id)
    return str(int(found[1])) if found and len(found[1]) < 10 else episode_id
