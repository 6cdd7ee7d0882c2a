"""Counting the messages of a file again, as they were counted when they were written."""

from __future__ import annotations

import mcap.records

from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.channels import Channel, channel_from
from station.episode.storage.progress import Gap
from station.episode.storage.records import RawMessage
from station.episode.writing.checkpoint import Checkpoint
from station.episode.writing.retell import Retelling

STAMPS_NUMBER = 1  # of the channel that holds the exact stamps
MOST_GAPS = 10_000  # beyond that only the counters go on


class Recount:
    """Takes the messages of a file in order; begins with what is known of it, if anything is.

    Attributes:
        channels, gaps, messages, retelling: As in `station.episode.writing.file.EpisodeFile`.
        last_log_ns: Log time of the last message [ns].
    """

    def __init__(self, anchor: Anchor, known: Checkpoint | None, file: str = layout.SIGNALS) -> None:
        self._file = file
        self.retelling = Retelling(anchor, known.told if known else None)
        self.channels: dict[int, Channel] = {}
        self.gaps: list[Gap] = []
        self.messages = self.last_log_ns = 0
        if known is not None:
            self.channels = {one.id: one.channel(file) for one in known.channels if one.id != STAMPS_NUMBER}
            self.gaps, self.messages, self.last_log_ns = known.gaps, known.messages, known.last_log_ns

    def take(self, message: RawMessage, record: mcap.records.Channel) -> None:
        """Count a message."""
        self.last_log_ns = message.log_ns
        self.retelling.take(message, record)
        channel = self.channels.get(message.channel_id)
        if channel is None:
            if record.topic == layout.STAMPS_TOPIC:
                return
            channel = self.channels[message.channel_id] = channel_from(record, self._file)
        before_ns = channel.last_ns
        if (lost := channel.note(message.sequence, message.log_ns)) and len(self.gaps) < MOST_GAPS:
            self.gaps.append(Gap(before_ns, message.log_ns, lost))
        self.messages += 1
