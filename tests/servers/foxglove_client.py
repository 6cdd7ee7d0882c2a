"""A client of the Foxglove protocol with nothing of ours or of the server's library: `websockets`, JSON, protobuf.

The protocol: foxglove/ws-protocol, ``docs/spec.md``, as ``foxglove.sdk.v1``.
"""

from __future__ import annotations

import base64
import contextlib
import json
import socket
import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.sync.client import connect

from tests.waiting import DEADLINE_S

SUBPROTOCOL = "foxglove.sdk.v1"
_MESSAGE_DATA = 1


class Received(NamedTuple):
    """A message: its topic, log time [ns since the epoch], bytes, and what they say by the schema of the channel."""

    topic: str
    log_ns: int
    data: bytes
    value: Any


class FoxgloveClient:
    """One connection.

    Args:
        url: Of the server.
        most_unread: Frames that are read from the socket before somebody asks for them.
        receive_bytes: What the socket holds unread at most, or so; 0 for what is usual.

    Attributes:
        info: What the server said of itself.
        channels: What it advertises, by topic.
        statuses: Its ``status`` and ``removeStatus`` messages, in order.
        messages: All that came, in order.
    """

    def __init__(self, url: str, *, most_unread: int = 10_000, receive_bytes: int = 0) -> None:
        self._held = contextlib.ExitStack()
        options: dict[str, Any] = {"max_size": None, "compression": None, "max_queue": most_unread}
        if receive_bytes:
            place = urlsplit(url)
            options["sock"] = plain = socket.socket()
            plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
            plain.connect((place.hostname, place.port))
        self._socket = self._held.enter_context(connect(url, subprotocols=[SUBPROTOCOL], **options))
        assert self._socket.subprotocol == SUBPROTOCOL
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.statuses: list[dict[str, Any]] = []
        self.messages: list[Received] = []
        self._subscriptions: dict[int, dict[str, Any]] = {}

    def send(self, operation: dict[str, Any]) -> None:
        """Send an operation of the protocol."""
        self._socket.send(json.dumps(operation))

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics, once each is advertised."""
        for topic in topics:
            self.until(lambda topic=topic: topic in self.channels)  # type: ignore[misc]
            number = 1000 + len(self._subscriptions)
            self._subscriptions[number] = self.channels[topic]
            self._ask(number)

    def unsubscribe(self, topic: str) -> None:
        """Take back a subscription."""
        numbers = [number for number, channel in self._subscriptions.items() if channel["topic"] == topic]
        self.send({"op": "unsubscribe", "subscriptionIds": numbers})

    def of(self, topic: str) -> list[Received]:
        """Return what came of a topic so far."""
        return [one for one in self.messages if one.topic == topic]

    def until(self, condition: Callable[[], object], timeout_s: float = DEADLINE_S) -> None:
        """Read until a condition holds."""
        end_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end_s, f"did not hold within {timeout_s:g} s; statuses {self.statuses[-3:]}"
            self.read(0.02)

    def read(self, timeout_s: float) -> None:
        """Read one frame, if one comes in time."""
        try:
            frame = self._socket.recv(timeout_s)
        except TimeoutError:
            return
        if isinstance(frame, bytes):
            self._on_data(frame)
        else:
            self._on_text(json.loads(frame))

    def close(self) -> None:
        """Hang up."""
        self._held.close()

    def _ask(self, number: int) -> None:
        channel = self._subscriptions[number]["id"]
        self.send({"op": "subscribe", "subscriptions": [{"id": number, "channelId": channel}]})

    def _on_text(self, said: dict[str, Any]) -> None:
        match said["op"]:
            case "serverInfo":
                self.info = said
            case "advertise":
                self.channels |= {channel["topic"]: channel for channel in said["channels"]}
            case "unadvertise":
                gone = set(said["channelIds"])
                self.channels = {topic: one for topic, one in self.channels.items() if one["id"] not in gone}
            case "status" if said["message"].startswith("Unknown channel ID: "):
                # foxglove-sdk 0.30.3 advertises a channel a moment before it takes subscriptions to it.
                refused = int(said["message"].rpartition(" ")[2])
                for number, channel in self._subscriptions.items():
                    if channel["id"] == refused and channel in self.channels.values():
                        self._ask(number)
            case "status" | "removeStatus":
                self.statuses.append(said)
            case other:
                raise AssertionError(f"unexpected operation {other}")

    def _on_data(self, frame: bytes) -> None:
        kind, number, log_ns = struct.unpack_from("<BIQ", frame)
        assert kind == _MESSAGE_DATA
        channel, data = self._subscriptions[number], frame[13:]
        self.messages.append(Received(channel["topic"], log_ns, data, _value(channel, data)))


def fields(channel: dict[str, Any]) -> list[str]:
    """Return the names of the fields of a protobuf channel's message type, in order."""
    return [field.name for field in _class_of(channel).DESCRIPTOR.fields]


def _value(channel: dict[str, Any], data: bytes) -> Any:
    if channel["encoding"] == "json":
        assert channel["schemaEncoding"] == "jsonschema"
        assert json.loads(channel["schema"])["type"] == "object"
        found = json.loads(data)
        assert isinstance(found, dict), "the app takes no other JSON"
        return found
    return _class_of(channel).FromString(data)


def _class_of(channel: dict[str, Any]) -> Any:
    assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
