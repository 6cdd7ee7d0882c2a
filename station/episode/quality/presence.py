"""From when to when each rated key was written, beside the ends of the episode; and losses that servers told of.

A stream is silent between its messages, which has rules of its own; here is what is missing before its first and after
its last one, and between two processes that wrote one key after the other. Commands may begin when they like, and may
end where their server says so: with one of the events of `station.episode.quality.pauses`, or with its farewell.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, get_args

from station.bus import codec, keys
from station.episode.quality.finding_parts import KeyPresence, Loss, LossKind, Silence
from station.episode.quality.findings import StreamQuality
from station.episode.quality.pauses import End
from station.episode.reading.messages import Message
from station.episode.storage import layout, pictures
from station.episode.storage.bulk import names_of
from station.episode.storage.manifest import Manifest

_BLEND_S = 5.0  # how long a server goes on commanding, towards standing, after it has said that its commands end
_NEAR_S = 2.0  # a word that comes later than that after the last write does not say why there was none
_BUS_LOST = "bus-lost"
_FINALIZED = "finalized"
_WORKS = ("inactive", "active")  # before, it loads what it needs; from one to the other it may have to connect
_RECORDER = "recorder"
_JUDGED = ("command", "state", "policy", "sensor")
_MOST = 1000  # losses that are listed; a file that was built to harm may hold millions
_LONGEST_TEXT = 200


@dataclass
class Heartbeats:
    """Takes the heartbeats of servers.

    Attributes:
        start_ns: Start of the episode [ns since the epoch].
        alive: Names of servers that lived during the episode.
        farewells: Sources that said that they end, and when first [ns since the epoch].
        silences: By server, when it was silent for longest between two words that it works, and for how long [ns].
    """

    start_ns: int
    alive: set[str] = field(default_factory=set)
    farewells: dict[str, int] = field(default_factory=dict)
    silences: dict[str, tuple[int, int]] = field(default_factory=dict)
    _said: dict[str, tuple[int, object]] = field(
        default_factory=dict
    )  # by source: last word, when [ns], in the episode

    def feed(self, message: Message) -> None:
        """Add a message; any other is passed over."""
        if not message.topic.startswith(keys.SERVER_PREFIX) or message.channel.is_deletion:
            return
        state, source = _state(message.data), message.channel.source
        name, before = message.topic.removeprefix(keys.SERVER_PREFIX), self._said.pop(source, None)
        if state == _FINALIZED:
            self.farewells.setdefault(source, message.log_ns)
        elif message.log_ns >= self.start_ns:
            self.alive.add(name)
            self._said[source] = message.publish_ns, state
            if before is not None and before[1] == state and state in _WORKS:
                silence = before[0], message.publish_ns - before[0]
                self.silences[name] = max(self.silences.get(name, silence), silence, key=lambda one: one[1])


def ends_s(manifest: Manifest, streams: Sequence[StreamQuality]) -> tuple[float, float]:
    """Return from when to when there is an episode [s from its start].

    Where the manifest does not tell, or the recorder waited for a bus that did not come back, the first and the last
    message do.
    """
    first_s = min((stream.first_s for stream in streams), default=0.0)
    last_s = max((stream.last_s for stream in streams), default=0.0)
    duration_s = manifest.timing.duration_s
    if duration_s is None:
        return first_s, last_s
    return 0.0, last_s if manifest.recorder.ended_by == _BUS_LOST else duration_s


def find(
    streams: Iterable[StreamQuality], span_s: tuple[float, float], ends: Sequence[End], heard: Heartbeats
) -> list[KeyPresence]:
    """Return how each rated key lies in the episode, by key, of all writers.

    Args:
        streams: Of the episode.
        span_s: Its ends, as `ends_s`.
        ends: Where servers said that their commands end.
        heard: Heartbeats of servers.
    """
    by_key: dict[str, list[StreamQuality]] = defaultdict(list)
    for stream in streams:
        if stream.role in _JUDGED and stream.nominal_hz is not None:
            by_key[stream.key].append(stream)
    groups = (sorted(by_key[key], key=lambda stream: stream.first_s) for key in sorted(by_key))
    return [_presence(group, span_s, ends, heard) for group in groups]


def without_pictures(manifest: Manifest, seen: Iterable[str], heard: Heartbeats) -> list[str]:
    """Return the keys of cameras and lidars that were there by the manifest, and of which there is no picture or cloud.

    A bus remembers configurations of servers that are long gone: where there are heartbeats, a sensor counts that has
    one.
    """
    listed = {str(facts.get("key")) for facts in manifest.cameras}
    stated = {
        str(one.get("key"))
        for name, facts in manifest.servers.items()
        if name in heard.alive or not heard.alive
        for one in pictures.stated(facts)
    }
    return sorted(key for key in (listed | stated) - set(seen) if names_of(key) is not layout.SIGNALS_NAMES)


def silences(heard: Heartbeats) -> list[Silence]:
    """Return the longest silence of each server between two words that it works, the recorder's apart.

    A pause of that one loses nothing: it takes up the bus's stream where it was.
    """
    return [
        Silence(server=name, at_s=round((at_ns - heard.start_ns) * 1e-9, 3), seconds=round(lasted_ns * 1e-9, 3))
        for name, (at_ns, lasted_ns) in sorted(heard.silences.items())
        if name != _RECORDER
    ]


def losses(events: Iterable[tuple[float, Mapping[str, Any]]], manifest: Manifest) -> list[Loss]:
    """Return servers that died, and cameras and lidars that were lost, during the episode, by the recorded events."""
    found: list[Loss] = []
    for at_s, event in events:
        kind = next((kind for kind in get_args(LossKind) if kind == event.get("name")), None)
        if kind is None or at_s < 0 or len(found) >= _MOST:
            continue
        detail = event.get("detail")
        detail = detail if isinstance(detail, Mapping) else {}
        server = str(detail.get("server", event.get("source", "")))[:_LONGEST_TEXT]
        role = str(manifest.servers.get(server, {}).get("role", ""))
        if _RECORDER not in (role, server):
            reason = str(detail.get("reason", ""))[:_LONGEST_TEXT]
            found.append(Loss(kind=kind, server=server, role=role, at_s=round(at_s, 3), reason=reason))
    return found


def _presence(
    group: Sequence[StreamQuality], span_s: tuple[float, float], ends: Sequence[End], heard: Heartbeats
) -> KeyPresence:
    last = max(group, key=lambda stream: stream.last_s)
    farewell_ns = heard.farewells.get(last.source)
    told_s = [] if farewell_ns is None else [(farewell_ns - heard.start_ns) * 1e-9]
    told_s += [(end.at_ns - heard.start_ns) * 1e-9 for end in ends if end.source == last.source]
    return KeyPresence(
        key=last.key,
        role=last.role,
        writer=last.writer,
        nominal_hz=last.nominal_hz or 0.0,
        late_s=max(0.0, group[0].first_s - span_s[0]),
        early_s=max(0.0, span_s[1] - last.last_s),
        between_s=max(_between(group), default=0.0),
        is_end_told=any(-_BLEND_S <= at_s - last.last_s <= _NEAR_S for at_s in told_s),
    )


def _between(group: Sequence[StreamQuality]) -> Iterator[float]:
    """Yield the silences between writers that followed each other [s]."""
    until_s = group[0].last_s
    for before, stream in pairwise(group):
        until_s = max(until_s, before.last_s)
        yield stream.first_s - until_s


def _state(heartbeat: bytes) -> object:
    try:
        facts = codec.parse_json(heartbeat)
    except codec.BadValue:
        return None
    return facts.get("state") if isinstance(facts, dict) else None
