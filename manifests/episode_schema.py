"""The JSON schema of an episode's manifest, made from `station.episode.storage.manifest.Manifest`."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path
from typing import Any

import msgspec

from station.episode.storage.manifest import Manifest

SCHEMA_FILE = Path(__file__).with_name("episode.schema.json")
EXAMPLE_FILE = Path(__file__).with_name("episode.example.yaml")

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NOT_IN_THE_FILE = "foreign"  # what of other tools we keep stands at its own place in the document
_ATTRIBUTE = re.compile(r"^    (?P<names>\w+(?:, \w+)*): (?P<text>.+)$")


def episode_schema() -> dict[str, Any]:
    """Return the schema; fields beyond it are allowed, since other tools may add theirs."""
    schema = msgspec.json.schema(Manifest)
    for part in schema["$defs"].values():
        _document(part)
    del schema["$defs"][Manifest.__name__]["properties"][_NOT_IN_THE_FILE]
    return {"$schema": _DIALECT, **schema}


def episode_schema_text() -> str:
    """Return the schema as it stands in the file."""
    return json.dumps(episode_schema(), indent=2, ensure_ascii=False) + "\n"


def _document(part: dict[str, Any]) -> None:
    """Move what the docstring of a struct says of its fields to the fields."""
    summary, _, attributes = inspect.cleandoc(part.get("description", "")).partition("\n\nAttributes:\n")
    part["description"] = summary
    fields: list[dict[str, Any]] = []
    for line in attributes.splitlines():
        begins = _ATTRIBUTE.match(line)
        if begins:
            fields = [part["properties"][name] for name in begins["names"].split(", ")]
        for field in fields:
            text = begins["text"] if begins else line.strip()
            field["description"] = f"{field.get('description', '')} {text}".strip()
