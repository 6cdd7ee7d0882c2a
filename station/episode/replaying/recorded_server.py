"""The low-level server of an episode: what it stated, and its configuration as the type that it has here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from station import registry
from station.control.gate import GateConfig
from station.control.rig import RigConfig
from station.episode.reading.reader import EpisodeReader
from station.episode.storage import layout
from station.errors import EpisodeError, UnknownName
from station.life.server import ServerKind


class LowLevelConfig(msgspec.Struct):
    """What a replay needs of the configuration of a low-level server."""

    rig: RigConfig
    gate: GateConfig
    is_armed: bool


def facts_of(reader: EpisodeReader, robot: str) -> dict[str, Any]:
    """Return what the low-level server of a robot has stated.

    Raises:
        EpisodeError: none has.
    """
    for facts in reader.manifest.servers.values():
        if facts.get("role") == "low-level" and facts.get("robot") == robot:
            return facts
    raise EpisodeError(
        f"episode {reader.episode_id}: no low-level server has stated its configuration for {robot!r}, "
        "so the simulation cannot be set up as it was"
    )


def configuration(reader: EpisodeReader, facts: Mapping[str, Any]) -> LowLevelConfig:
    """Read the configuration that a server stated as the type of its kind.

    Raises:
        EpisodeError: its kind is not installed here, or is an arm's, or has another configuration by now.
    """
    # Servers told their name alone, once: that of their kind, unless they were given another with --name.
    name, is_told = str(facts.get("kind", facts.get("server"))), "kind" in facts
    hint = "" if is_told else f"; if that name was given with --name, write `kind: KIND` into {_place(reader, facts)}"
    try:
        kind: ServerKind = registry.find("server", name)
        config: Any = msgspec.convert(facts.get("config"), kind.config)
    except UnknownName as error:
        what = "of a kind that is not installed here" if is_told else "called like no kind that is installed here"
        raise EpisodeError(
            f"episode {reader.episode_id}: its low-level server is {what}: {error}; "
            f"install the package that has it{hint}"
        ) from error
    except msgspec.ValidationError as error:
        raise EpisodeError(
            f"episode {reader.episode_id}: the configuration of its {kind.name} server is none of this version: "
            f"{error}{hint}"
        ) from error
    if not hasattr(config, "rig"):
        raise EpisodeError(
            f"episode {reader.episode_id}: an arm's controller keeps its own time, so its motion is not computed "
            f"again; `station audit` derives its targets, and `station serve {kind.name}` with `station replay "
            "--to bus --allow-live` moves a simulated one"
        )
    return LowLevelConfig(config.rig, config.gate, config.is_armed)


def _place(reader: EpisodeReader, facts: Mapping[str, Any]) -> str:
    """Return where a server stands in the manifest, for a person."""
    name = next((name for name, each in reader.manifest.servers.items() if each is facts), facts.get("server"))
    return f"servers.{name} of {reader.folder / layout.MANIFEST}"
