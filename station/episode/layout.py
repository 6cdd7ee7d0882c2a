"""What an episode looks like on disk: names of files, topics, encodings and records, spelled once.

``DATA/<task>/<episode_id>/{manifest.yaml, signals.mcap}``; the MCAP file is called ``signals.mcap.active`` until it
is finished, and ``resume.json`` beside it says how far a killed recorder had got.
"""

from __future__ import annotations

MANIFEST = "manifest.yaml"
SIGNALS = "signals.mcap"
ACTIVE = "signals.mcap.active"
RESUME = "resume.json"

PROFILE = "teleop-station"
STAMPS_TOPIC = "station:recorder:stamps"
"""Once per flush, one message with a line ``<channel_id> <exact stamp>`` per native message of that flush."""

JSON = "json"
BYTES = "application/octet-stream"
DELETED = "application/x-deleted"
TEXT = "text"

FOREIGN = "foreign"
NO_CONTRACT = "none"

ANCHOR_RECORD = "station.anchor"
EPISODE_RECORD = "station.episode"
SUMMARY_RECORD = "station.summary"
MANIFEST_MEDIA_TYPE = "application/yaml"
