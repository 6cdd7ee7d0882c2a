"""The schema in the repository is that of the types, and the example is a manifest."""

from __future__ import annotations

from typing import Any

import msgspec
import yaml

from manifests.episode_schema import EXAMPLE_FILE, SCHEMA_FILE, episode_schema, episode_schema_text
from station.episode.storage.manifest import Manifest, dump_manifest, load_manifest


def properties(schema: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = schema["$defs"][name]["properties"]
    return found


def test_schema_is_up_to_date() -> None:
    assert SCHEMA_FILE.read_text(encoding="utf-8") == episode_schema_text(), "run: python -m manifests"


def test_schema_names_exactly_what_is_written() -> None:
    written = yaml.safe_load(dump_manifest(Manifest()))
    schema = episode_schema()
    assert set(properties(schema, "Manifest")) == set(written)
    for part in ("task", "operator", "robot", "policy", "recorder"):
        assert set(properties(schema, part.capitalize())) == set(written[part]), part


def test_example_is_a_manifest_without_a_field_that_we_do_not_know() -> None:
    example = load_manifest(EXAMPLE_FILE)
    assert example.foreign == {}
    assert (example.state, example.quality["verdict"]) == ("finished", "good")
    assert msgspec.convert(msgspec.to_builtins(example), Manifest) == example
