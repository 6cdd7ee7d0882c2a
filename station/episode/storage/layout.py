"""What an episode looks like on disk: names of files, topics, encodings and records, spelled once.

``DATA/<task>/<episode_id>/{manifest.yaml, signals.mcap, cameras.mcap, clouds.mcap}``; pictures are in ``cameras.mcap``
and point clouds in ``clouds.mcap``, which are there when there was one, everything else in ``signals.mcap``. An MCAP
file is called ``….active`` until it is finished, and ``resume.json`` beside it says how far a killed recorder had got,
``checkpoint.json`` what it knew of the files some seconds before. A repaired episode keeps what was torn beside it, as
``….torn``.
"""

from __future__ import annotations

from typing import NamedTuple


class Names(NamedTuple):
    """What an MCAP file of an episode is called: in the end, while it is written, put aside as torn, while repaired."""

    final: str
    active: str
    torn: str
    repairing: str


def _names(final: str) -> Names:
    return Names(final, f"{final}.active", f"{final}.torn", f"{final}.repairing")


MANIFEST = "manifest.yaml"
MANIFEST_START = "manifest.start.yaml"
"""The attachment at the head of the signals: the manifest before the first write. Earlier stations gave it the name of
the one at their end."""

SIGNALS_NAMES = _names("signals.mcap")
CAMERAS_NAMES = _names("cameras.mcap")
CLOUDS_NAMES = _names("clouds.mcap")
BULK_NAMES = (CAMERAS_NAMES, CLOUDS_NAMES)
"""Of the files that an episode may do without, in the order in which they are read at equal times, behind signals."""
ALL_NAMES = (SIGNALS_NAMES, *BULK_NAMES)
SIGNALS, ACTIVE, TORN, REPAIRING = SIGNALS_NAMES
CAMERAS, CAMERAS_ACTIVE, *_ = CAMERAS_NAMES
CLOUDS = CLOUDS_NAMES.final
RESUME = "resume.json"
CHECKPOINT = "checkpoint.json"

PROFILE = "teleop-station"
STAMPS_TOPIC = "station:recorder:stamps"
"""Once per flush, one message with a line ``<channel_id> <exact stamp>`` per native message of that flush."""

RECORDER = "recorder"
"""Writer of that topic; a stranger's key of the same name has another."""

JSON = "json"
BYTES = "application/octet-stream"
DELETED = "application/x-deleted"
TEXT = "text"
PROTOBUF = "protobuf"
"""Of a picture: the exact bytes of the key are the field ``data`` of a ``foxglove.CompressedImage``; of a channel whose
metadata say `VIDEO`, a picture of H.264 is that of a ``foxglove.CompressedVideo``. Of a cloud: they are the
``foxglove.PointCloud`` but for its time."""
VIDEO = "video"
"""In the metadata of a channel of pictures that were compacted: of what format they are since."""

FOREIGN = "foreign"
NO_CONTRACT = "none"

ANCHOR_RECORD = "station.anchor"
ON_EPISODE_CLOCK = {"clock": "episode"}
"""Of a channel of another machine: its times of writing are on the episode's clock; in older files, on its own."""
EPISODE_RECORD = "station.episode"
SUMMARY_RECORD = "station.summary"
DROPPED_RECORD = "station.dropped"
"""What was dropped so far, per key and writer; the last such record counts, and there is none where nothing was."""
COMPACTED_RECORD = "station.compacted"
"""In a file of pictures that were compacted: what its manifest says of that, and which file it was made of."""

MANIFEST_MEDIA_TYPE = "application/yaml"
