"""What a robot's keys say of a row in words: the state of its gate, and who commands it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, get_args

from station.bus import codec, keys
from station.control.gate import State
from station.episode.reading.messages import Message

GATE_STATES: tuple[str, ...] = get_args(State)
"""States of a gate by number; nothing else is a state, so the numbers mean the same in every data set."""

_LONGEST = 60  # of a name; anybody may write commands

Spell = Callable[[Message], str]


def spellings(robot: str) -> Mapping[str, Spell]:
    """Return the keys of a robot that speak in words, each with what makes one word of a message; "" for none."""
    return {keys.command_gate(robot): _gate_state, keys.command_source(robot): _commander} if robot else {}


def _gate_state(message: Message) -> str:
    return str(codec.parse_facts(message.data).get("state", ""))[:_LONGEST]


def _commander(message: Message) -> str:
    """Return the server that commands, and its device or the file of its motion."""
    facts: dict[str, Any] = codec.parse_facts(message.data)
    what = str(facts.get("device") or "") or str(facts.get("file") or "").rpartition("/")[2]
    return f"{message.channel.writer} {what}".strip()[:_LONGEST]
