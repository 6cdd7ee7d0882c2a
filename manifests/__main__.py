"""``python -m manifests``: write the schema anew after the types have changed."""

from __future__ import annotations

from manifests.episode_schema import SCHEMA_FILE, episode_schema_text

SCHEMA_FILE.write_text(episode_schema_text(), encoding="utf-8")
