"""The type of messages that hold pictures, as a file describes it."""

from __future__ import annotations

from mcap.records import Schema


def picture_type() -> Schema:
    """Return the description of ``foxglove.CompressedImage``."""
    from station.protobuf import foxglove, schema  # 30 ms and 7 MB, of which a station without cameras needs nothing

    made = foxglove.schema(foxglove.COMPRESSED_IMAGE)
    return Schema(id=1, name=made.name, encoding=schema.ENCODING, data=made.data)
