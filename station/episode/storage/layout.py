"""What an episode looks like on disk: names of files, topics, encodings and records, spelled once.

``DATA/<task>/<episode_id>/{manifest.yaml, signals.mcap}``; the MCAP file is called ``signals.mcap.active`` until it
is finished, and ``resume.json`` beside it says how far a killed recorder had got,
``checkpoint.json`` what it knew of the file some seconds before. A repaired episode keeps what was
torn beside it, as ``signals.mcap.torn``.
"""

from __future__ import annotations

MANIFEST = "manifest.yaml"
SIGNALS = "signals.mcap"
ACTIVE = "signals.mcap.active"
RESUME = "resume.json"
CHECKPOINT = "checkpoint.json"
TORN = "signals.mcap.torn"
REPAIRING = "signals.mcap.repairing"

PROFILE = "teleop-station"
STAMPS_TOPIC = "station:recorder:stamps"
"""Once per flush, one message with a line ``<channel_id> <exact stamp>`` per native message of that flush."""

RECORDER = "recorder"
"""Writer of that topic; a stranger's key of the same name has another."""

JSON = "json"
BYTES = "application/octet-stream"
DELETED = "application/x-deleted"
TEXT = "text"

FOREIGN = "foreign"
NO_CONTRACT = "none"

ANCHOR_RECORD = "station.anchor"
EPISODE_RECORD = "station.episode"
SUMMARY_RECORD = "station.summary"
DROPPED_RECORD = "station.dropped"
"""What was dropped so far, per key and writer; the last such record counts, and there is none where nothing was."""

MANIFEST_MEDIA_TYPE = "application/yaml"
