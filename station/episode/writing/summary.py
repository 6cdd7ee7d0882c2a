"""What a manifest says of the messages: told live as they arrive, and told again from the file after a recorder died.

Everything here follows from the messages alone, so a recorder that takes an episode up again, and a repair, come to
the same words as the recorder that was killed.
"""

from __future__ import annotations

from typing import Any

import msgspec
from mcap.records import Channel

from station.bus import codec, keys
from station.bus.tap import not_mirrored
from station.episode.storage import layout
from station.episode.storage import manifest as manifests
from station.episode.storage.anchor import Anchor
from station.episode.storage.bounds import cut
from station.episode.storage.manifest import Event, Manifest, Mark, Recorder
from station.episode.storage.records import RawMessage
from station.episode.storage.request import RecordRequest, parse_request, request_id
from station.episode.writing.checkpoint import SummaryState
from station.episode.writing.servers_seen import (
    LARGEST_CONFIGURATION,
    MAX_SERVERS,
    add_motion,
    count_shortened,
    is_motion,
    statement,
)
from station.errors import Refused

_LARGEST_EVENT = 20_000  # as `bounds.size_of` estimates it
_LONGEST_EVENT = 8192  # bytes; a longer one stands in the signals, the manifest says how long
_MOST_NOT_MIRRORED = 100
_LONGEST_KEY = 200
_MOST_NUMBERS = 100  # likewise
_LONGEST_TEXT = 2000  # of a name or a label, as `bounds.size_of` estimates it
_MOST_REQUESTS = 256  # the newest; a request is sent again for some seconds at most
_TOLD = ("events", "marks", "motions")  # sections that follow from the messages alone
_EVENT_FIELDS = ("name", "severity", "source", "wall_ns", "detail")


def add_event(manifest: Manifest | SummaryState, value: bytes, at_s: float) -> None:
    """Put an event into a manifest; `at_s` is its arrival from the start of the episode [s]."""
    stated = statement(value, _LARGEST_EVENT)
    facts = stated.value if stated else {"name": "undecodable", "severity": "warning"}
    is_short = len(value) <= _LONGEST_EVENT and codec.is_modest(facts, values=_MOST_NUMBERS)
    name, severity, source = (
        cut(str(facts.get(field, default)), _LONGEST_TEXT)
        for field, default in (("name", "unnamed"), ("severity", "info"), ("source", ""))
    )
    event = Event(
        at_s=at_s,
        name=name.value,
        severity=severity.value,
        source=source.value,
        numbers=_numbers(facts) if is_short else {"bytes": len(value)},
    )
    if at_s >= 0:
        flags = manifest.quality_flags
        flags.falls += event.name == "fall"
        flags.operator_reset |= event.name == "operator-reset"
        flags.estop |= event.name == "estop"
    if len(manifest.events) >= manifests.MAX_EVENTS:
        manifest.events_not_listed += 1
        return
    manifest.events.append(event)
    in_it = stated.cuts if stated and is_short else 0
    count_shortened(manifest, "events", in_it + (not is_short) + name.cuts + severity.cuts + source.cuts)


def add_mark(manifest: Manifest | SummaryState, label: str, at_s: float, success: bool | None) -> bool:
    """Put a mark into a manifest; False when there are too many already."""
    if len(manifest.marks) >= manifests.MAX_MARKS:
        return False
    text, count = cut(label, _LONGEST_TEXT)
    manifest.marks.append(Mark(at_s=at_s, label=text))
    count_shortened(manifest, "marks", count)
    if success is not None:
        manifest.quality_flags.success = success
    return True


def count_not_mirrored(account: Recorder | SummaryState, value: bytes) -> None:
    """Count what a tap said of writes that it could not show."""
    said = not_mirrored.decode(value) or not_mirrored.NotMirrored("?", "")
    account.not_mirrored += said.count
    which = f"{said.command} {said.key[:_LONGEST_KEY]}"
    if which in account.not_mirrored_by or len(account.not_mirrored_by) < _MOST_NOT_MIRRORED:
        account.not_mirrored_by[which] = account.not_mirrored_by.get(which, 0) + said.count


class EpisodeSummary:
    """Takes the messages of a file in order and tells what follows from them.

    Attributes:
        told: What they told so far.
    """

    def __init__(self, anchor: Anchor, told: SummaryState | None = None) -> None:
        """Begin with the first message of a file with a clock, or go on behind what was told."""
        self.told = told or SummaryState()
        self._anchor = anchor
        self._wanted: dict[int, bool] = {}

    def on_message(self, message: RawMessage, channel: Channel) -> None:
        """Add one message."""
        wanted = self._wanted.get(message.channel_id)
        if wanted is None:
            wanted = self._wanted[message.channel_id] = is_told(channel.topic, channel.message_encoding)
        if wanted:
            self.on_value(channel.topic, message.data, message.log_ns)

    def on_value(self, key: str, value: bytes, log_ns: int) -> None:
        """Add the value of a key that `is_told`."""
        at_s = round((log_ns - self._anchor.wall_ns) * 1e-9, 6)
        if key == keys.EVENT:
            add_event(self.told, value, at_s)
        elif key == keys.RECORD:
            self._request(value, at_s)
        elif key == keys.NOT_MIRRORED:
            count_not_mirrored(self.told, value)
        elif is_motion(key):
            add_motion(self.told, key, value)
        elif (stated := statement(value, LARGEST_CONFIGURATION)) is not None:
            name = key.removeprefix(keys.CONFIG_PREFIX)
            if name in self.told.servers or len(self.told.servers) < MAX_SERVERS:
                self.told.servers[name] = stated.value

    def apply(self, manifest: Manifest, first_ns: int) -> None:
        """Have a manifest say what the messages say: it was saved before, or after, what the file holds.

        Args:
            manifest: It is changed.
            first_ns: Log time of the first message [ns]; 0 without messages.
        """
        told = self.told
        manifest.events, manifest.marks, manifest.motions = list(told.events), list(told.marks), list(told.motions)
        manifest.events_not_listed = told.events_not_listed
        others = {name: count for name, count in manifest.shortened.items() if name not in _TOLD}
        manifest.shortened = {**others, **told.shortened}
        manifest.quality_flags = msgspec.structs.replace(told.quality_flags)
        manifest.recorder.not_mirrored = told.not_mirrored
        manifest.recorder.not_mirrored_by = dict(told.not_mirrored_by)
        manifest.servers = {**manifest.servers, **told.servers}
        if first_ns:
            manifest.timing.preroll_s = max(0.0, round((self._anchor.wall_ns - first_ns) * 1e-9, 6))

    def _request(self, value: bytes, at_s: float) -> None:
        asker = request_id(value)
        if asker is None or asker in self.told.requests or at_s < 0:
            return
        self.told.requests.append(asker)
        del self.told.requests[:-_MOST_REQUESTS]
        try:
            request = parse_request(value)
        except Refused:  # it was refused then as well
            return
        if request.action == "mark":
            add_mark(self.told, request.label, at_s, request.success)
        elif request.action in ("stop", "discard"):
            self._end(request, at_s)

    def _end(self, request: RecordRequest, at_s: float) -> None:
        flags = self.told.quality_flags
        self.told.ending = request
        if request.success is not None:
            flags.success = request.success
        if request.action == "discard":
            flags.discarded = True
            if request.label:
                add_mark(self.told, f"discarded: {request.label}", at_s, None)


def is_told(key: str, encoding: str) -> bool:
    """Whether a manifest says something of the values of a key."""
    is_of_interest = (
        key in (keys.EVENT, keys.RECORD, keys.NOT_MIRRORED) or is_motion(key) or key.startswith(keys.CONFIG_PREFIX)
    )
    return is_of_interest and encoding != layout.DELETED


def _numbers(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the detail of an event, and whatever a foreign writer put beside it."""
    beside = {name: value for name, value in facts.items() if name not in _EVENT_FIELDS}
    detail = facts.get("detail", {})
    return {**beside, **(detail if isinstance(detail, dict) else {"detail": detail})}
