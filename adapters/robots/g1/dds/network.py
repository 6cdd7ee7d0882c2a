"""A participant on a robot's DDS network, and messages as bytes. Needs the extra ``g1``.

Messages that come often are taken and written as they are on the wire: a class whose ``serialize`` and ``deserialize``
pass bytes on has the name and the hash of the type that it stands for. To make an object of each motor takes 0.4 ms,
and the bytes are what is recorded.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any, Self

from cyclonedds._clayer import ddspy_take
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from adapters.robots.g1.dds.options import LOOPBACK, NetworkOptions
from station.errors import ConfigError, StationError

_MOST_DISCOVERED = 4096
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_BY_NAMES = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
"""How Fast DDS (1.15 of the OMG's vendors), which most of ROS 2 uses, describes types that have sequences or arrays,
Cyclone 11.0 takes for none, and hears and is heard by nobody on their topics: it goes by the names of types there.
Cyclone before 11 does not know the word, and reads no settings with it."""

# What Unitree's SDK asks for, read from the wire; a reader asks for no more, since what the robot offers is not known.
_WRITES = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(1),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


@dataclass(frozen=True, slots=True)
class RemoteWriter:
    """Another program that writes a topic, as its DDS participant describes itself. It is not verified.

    Attributes:
        host, pid, process: Where it runs; "" where it does not say.
    """

    host: str
    pid: str
    process: str

    def __str__(self) -> str:
        where = f"{self.process or 'a process'} (pid {self.pid or 'unknown'})"
        return f"{where} on {self.host or 'an unknown host'}"


log = logging.getLogger(__name__)

_RAW: dict[type[IdlStruct], type[IdlStruct]] = {}


class RawMessage:
    """A message as it came.

    Attributes:
        data: Header and body.
        sample_info: What DDS says of it.
    """

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None


def raw(kind: type[IdlStruct]) -> type[IdlStruct]:
    """Return a type of the same name and hash, always the same one, whose messages are bytes."""
    if kind in _RAW:
        return _RAW[kind]
    annotations = {name: kind.__annotations__[name] for name in kind.__annotations__}
    made: Any = make_idl_struct(kind.__name__, kind.__idl_typename__, annotations)
    made.serialize = lambda self, **_: self.data
    made.deserialize = classmethod(lambda cls, data, **_: RawMessage(data))
    made.deserialize_key = classmethod(lambda cls, data, **_: None)
    _RAW[kind] = made
    return made  # type: ignore[no-any-return]


class Network:
    """A participant; a context manager.

    Args:
        options: Where the robot is.

    Raises:
        ConfigError: there is no such interface, or DDS cannot use it.
    """

    _domains: dict[int, tuple[str, Domain]] = {}  # noqa: RUF012 - DDS has one of each in a process

    def __init__(self, options: NetworkOptions) -> None:
        self.options = options
        config = cyclone_config(options.interface, _BY_NAMES)
        known = self._domains.get(options.domain)
        if known is not None and known[0] != config:
            raise ConfigError(f"domain {options.domain}: this process has opened it on another network interface")
        try:
            if known is None:
                self._domains[options.domain] = (config, Domain(options.domain, config))
            self._participant = DomainParticipant(options.domain)
        except DDSException as error:
            self._domains.pop(options.domain, None)
            raise ConfigError(
                f"interface {options.interface!r}: DDS cannot use it ({error.msg or error}); is it up, and does it "
                "have an address? `ip -br address` lists interfaces"
            ) from None
        self._topics: dict[tuple[str, type[IdlStruct]], Topic[Any]] = {}
        self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._participants = BuiltinDataReader(self._participant, BuiltinTopicDcpsParticipant)
        self._news = ReadCondition(self._publications, ViewState.Any | InstanceState.Any | SampleState.NotRead)
        self._own = str(self._participant.guid)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the network; a second call does nothing."""
        self._participant.__del__()  # now, with all that is its own; else when the last reader is forgotten

    def reader(self, topic: str, kind: type[IdlStruct], depth: int, *, is_reliable: bool = False) -> Reader:
        """Return a reader that keeps the newest messages, so many as `depth`.

        A reliable one has lost packets sent again, which a message of many packets needs; it hears only writers that
        offer that.
        """
        reliable, best_effort = Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.Reliability.BestEffort
        wants = Qos(
            reliable if is_reliable else best_effort,
            Policy.History.KeepLast(depth),
            Policy.TypeConsistency.DisallowTypeCoercion(),
        )
        return Reader(DataReader(self._participant, self._topic(topic, raw(kind)), wants), kind, depth)

    def writer(self, topic: str, kind: type[IdlStruct]) -> TopicWriter:
        """Return a writer; messages are bytes where the type is `raw`, else of the type."""
        found = self._topic(topic, kind)
        return TopicWriter(DataWriter(self._participant, found, _WRITES), kind, topic)

    def have_writers_changed(self) -> bool:
        """Whether writers of whatever topic and type have come or gone since the last call, or one of `writers_of`."""
        is_news: bool = self._news.triggered
        if is_news:
            self._publications.read(_MOST_DISCOVERED, self._news)  # so that it is none the next time
        return is_news

    def writers_of(self, topic: str) -> list[RemoteWriter]:
        """Return the other programs that write a topic now; writers of this participant are left out."""
        alive = _alive(self._publications)
        found = [each for each in alive if each.topic_name == topic and str(each.participant_key) != self._own]
        said = {str(each.key): _properties(each) for each in _alive(self._participants)} if found else {}
        return [
            RemoteWriter(*(said.get(str(each.participant_key), {}).get(name, "") for name in _SAID)) for each in found
        ]

    def _topic(self, name: str, kind: type[IdlStruct]) -> Topic[Any]:
        if (name, kind) not in self._topics:
            self._topics[name, kind] = Topic(self._participant, name, kind)
        return self._topics[name, kind]


class Reader:
    """Takes what came since it was last asked.

    Args:
        reader: Of one topic, of a type that is `raw`.
        kind: The type itself.
        depth: Messages that it keeps; of more that come between two calls the oldest are lost.

    Attributes:
        malformed: Messages that were no objects of the type.
    """

    def __init__(self, reader: DataReader[Any], kind: type[IdlStruct], depth: int) -> None:
        self._reader, self._kind, self._depth = reader, kind, depth
        self.malformed = 0
        self._waits: WaitSet | None = None

    def wait(self, timeout_s: float) -> bool:
        """Wait for a message; return whether there is one. Other threads of the process go on."""
        if self._waits is None:
            self._waits = WaitSet(self._reader.participant)
            self._waits.attach(ReadCondition(self._reader, ViewState.Any | InstanceState.Any | SampleState.NotRead))
        return bool(self._waits.wait(duration(seconds=timeout_s)))

    def take(self) -> list[bytes]:
        """Return the messages since the last call as they came, header included, oldest first.

        Past `DataReader.take`, which makes an object of each: of ten states that is a third of the time.
        """
        taken = ddspy_take(self._reader._ref, _ANY, self._depth)
        if isinstance(taken, int):
            raise DDSException(taken, f"taking messages of {self._kind.__name__}")
        return [data for data, about in taken if about.valid_data]

    def take_stamped(self) -> list[RawMessage]:
        """As `take`, with what DDS says of each: when it was sent, by its sender's clock (``source_timestamp``)."""
        return [message for message in self._reader.take(self._depth) if isinstance(message, RawMessage)]

    def take_objects(self) -> list[Any]:
        """Return the messages since the last call as objects of the type, oldest first; what is none is counted."""
        found = []
        for data in self.take():
            try:
                found.append(self._kind.deserialize(data))
            except Exception as error:  # noqa: BLE001 - whatever a library makes of a stranger's bytes
                self.malformed += 1
                log.warning("a message that is no %s: %s", self._kind.__name__, type(error).__name__)
        return found


class TopicWriter:
    """Writes messages of one topic; of each writer the newest counts, so it never waits for a reader.

    Args:
        writer: Of one topic.
        kind: Its type.
        topic: Its name.
    """

    def __init__(self, writer: DataWriter[Any], kind: type[IdlStruct], topic: str) -> None:
        self._writer, self._topic = writer, topic
        self._message: Any = object.__new__(kind)

    def write(self, data: bytes) -> None:
        """Send a message that is bytes, header included.

        Raises:
            StationError: DDS did not take it.
        """
        self._message.data = data
        self.write_object(self._message)

    def write_object(self, message: IdlStruct) -> None:
        """Send a message that is an object of the topic's type.

        Raises:
            StationError: DDS did not take it.
        """
        try:
            self._writer.write(message)
        except DDSException as error:
            raise StationError(f"{self._topic}: DDS did not take a message ({error})") from None


_SAID = ("__Hostname", "__Pid", "__ProcessName")


def _alive(reader: BuiltinDataReader) -> list[Any]:
    condition = ReadCondition(reader, ViewState.Any | SampleState.Any | InstanceState.Alive)
    return [each for each in reader.read(_MOST_DISCOVERED, condition) if hasattr(each, "key") and hasattr(each, "qos")]


def _properties(participant: Any) -> dict[str, str]:
    return {policy.key: policy.value for policy in participant.qos if isinstance(policy, Policy.Property)}


def cyclone_config(interface: str, further: str = "") -> str:
    """Return what Cyclone DDS reads: one interface alone, and on loopback no multicast, which it does not have.

    Args:
        interface: Its name.
        further: More of a domain's settings.
    """
    is_local = interface == LOOPBACK
    multicast = "false" if is_local else "default"
    alone = (
        "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
        '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
    )
    return (
        '<CycloneDDS><Domain Id="any"><General><Interfaces>'
        f'<NetworkInterface name="{interface}" multicast="{multicast}"/></Interfaces>'
        f"{'<AllowMulticast>false</AllowMulticast>' if is_local else ''}</General>{alone if is_local else ''}"
        f"{further}</Domain></CycloneDDS>"
    )
