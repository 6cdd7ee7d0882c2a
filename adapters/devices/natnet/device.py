"""The connection to Motive, as a `station.operator.device.Device`.

- Nothing says that Motive is there: who asks is answered, and gets frames for as long as something is heard of him. So
  it is asked once a second; a Motive that was started anew is met again, with whatever it describes then.
- Datagrams are taken from the server's address alone; what cannot be read is counted and told, and changes nothing.
- A frame that comes late, behind a later one, is dropped. One from a clock that went back by more than a second is the
  first of another clock.
- Bones that are equal to the last bit for a tenth of a second are those of a take that is paused, or of an actor whom
  the cameras have lost: nobody stands so still. There is no body then, as where a bone is said not to be tracked.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
from collections.abc import Iterator
from typing import Any

from adapters.devices.natnet import wire
from adapters.devices.natnet.actor import Actor, NotAPerson
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.operator.sample import Body, OperatorSample

_ASK_S = 1.0
_ANSWER_S, _NAP_S = 0.3, 0.01
_RECENT_S = 0.5
_STILL_NS = 100_000_000
_BACK_NS = 1_000_000_000
_LARGEST = 65535
_MOST_READ = 1000  # datagrams of one look: whoever sends faster does not keep a server from its other work
_MOST_NS = 1 << 62
_ANY_PORT = 0


class Natnet:
    """Asks a server for its frames.

    Args:
        address: IPv4 address of the computer that Motive runs on.
        local: Of this computer, in the same network.
        port: UDP port of Motive's commands.
        group: Multicast group to join; "" for frames that Motive sends to this computer alone.
        data_port: UDP port of the group.
        actor: Name of the skeleton; "" for the only one.
        clock: Of the process.

    Raises:
        DeviceError: no such address here, a port that is in use, no route, or a version that is not understood.
    """

    def __init__(
        self,
        address: str = "127.0.0.1",
        local: str = "127.0.0.1",
        *,
        port: int = wire.COMMAND_PORT,
        group: str = "",
        data_port: int = wire.DATA_PORT,
        actor: str = "",
        clock: Clock = SYSTEM,
    ) -> None:
        self._server, self._local, self._wanted, self._clock = (address, port), local, actor, clock
        self._is_multicast = bool(group)
        self._info: wire.ServerInfo | None = None
        self._described: tuple[wire.Skeleton, ...] | None = None
        self._actor: Actor | None = None
        self._actor_id = 0
        self._why_not, self._unread, self._bad = "", "", 0
        self._newest_ns = -1
        self._still_since_ns, self._bones = 0, b""
        self._frames_at_ask = self._frames = 0
        self._heard_s = -math.inf
        self._sockets: list[socket.socket] = []
        try:
            self._sockets.append(_opened(local, _ANY_PORT))
            if group:
                self._sockets.append(_opened(group, data_port, join_on=local))
        except OSError as error:
            self.close()
            raise DeviceError(
                f"natnet: {local}{f' with {group}:{data_port}' if group else ''} cannot be listened to: "
                f"{error.strerror}; name this computer's address in Motive's network with local=…"
            ) from None
        self._next_ask_s = 0.0
        try:
            self._wait_for_answer()
        except DeviceError:
            self.close()
            raise

    def read(self) -> OperatorSample | None:
        """Return the newest frame as a sample, whose body is None where the actor is not tracked; None without one.

        Raises:
            DeviceError: no route to Motive any more, or a version that is not understood.
        """
        newest: tuple[int, wire.Frame] | None = None
        for data in self._received():
            try:
                found = self._met(data)
            except wire.BadPacket as error:
                self._bad += 1
                self._unread = f"{self._bad} packets could not be read, the last because of {error}"
                continue
            if found is not None and self._is_later(found[0]):
                self._newest_ns, newest = found[0], found
        self._ask()
        if newest is None or self._actor is None:
            return None
        try:
            body, self._why_not = self._body(self._actor, *newest), ""
        except NotAPerson as error:  # nothing that may be driven by, as if nothing came; `why_silent` tells
            self._why_not = str(error)
            return None
        return OperatorSample(capture_ns=newest[0], body=body)

    def why_silent(self) -> str:
        """Return what is missing: Motive, its frames, or the actor."""
        where = f"{self._server[0]}:{self._server[1]}"
        if self._info is None:
            return (
                f"no Motive answers at {where}; start it there, and switch on its NatNet streaming, with "
                f"{'multicast' if self._is_multicast else 'unicast'} and its Local Interface in this network"
            )
        if self._why_not:
            return self._why_not
        if self._unread:
            return self._unread
        if self._described is None:
            return f"{self._info.application} at {where} does not describe its skeletons; switch on Skeletons there"
        if self._clock.monotonic_s() - self._heard_s < _RECENT_S:
            return ""  # it does send; the first ones are not believed at once
        return f"{self._info.application} at {where} sends no frames; is it live, or does its take play?"

    def facts(self) -> dict[str, Any]:
        """Return where Motive is, and what it says of itself."""
        known = {"server": f"{self._server[0]}:{self._server[1]}", "actor": self._wanted or "the only one"}
        if self._info is None:
            return known
        version = ".".join(map(str, self._info.version))
        return known | {"application": self._info.application, "natnet": version}

    def close(self) -> None:
        """Let go of the sockets; a second call does nothing."""
        while self._sockets:
            self._sockets.pop().close()

    def _wait_for_answer(self) -> None:
        """Give a Motive that is there the moment that it needs to say so; one that is not may come later."""
        end_s = self._clock.monotonic_s() + _ANSWER_S
        while self._info is None and self._clock.monotonic_s() < end_s:
            self.read()
            self._clock.sleep(_NAP_S)

    def _received(self) -> Iterator[bytes]:
        for each in self._sockets:
            for _ in range(_MOST_READ):
                try:
                    data, sender = each.recvfrom(_LARGEST)
                except BlockingIOError:
                    break
                except OSError as error:
                    raise DeviceError(f"natnet: {self._server[0]} cannot be heard: {error.strerror}") from None
                if sender[0] == self._server[0]:
                    yield data

    def _ask(self) -> None:
        now_s = self._clock.monotonic_s()
        if now_s < self._next_ask_s:
            return
        self._next_ask_s = now_s + _ASK_S
        is_silent = self._frames == self._frames_at_ask
        self._frames_at_ask = self._frames
        self._send(wire.CONNECT if self._info is None or is_silent else wire.KEEP_ALIVE)
        if self._info is not None and self._actor is None:
            self._send(wire.REQUEST_DESCRIPTIONS)

    def _send(self, message: int) -> None:
        try:
            self._sockets[0].sendto(wire.request(message), self._server)
        except BlockingIOError:
            return  # asked again in a second
        except OSError as error:
            raise DeviceError(
                f"natnet: nothing can be sent to {self._server[0]} from {self._local}: {error.strerror}; name this "
                "computer's address in Motive's network with local=…"
            ) from None

    def _met(self, data: bytes) -> tuple[int, wire.Frame] | None:
        """Take a message in; return a frame with its time [ns]."""
        message, content = wire.opened(data)
        if message == wire.SERVER_INFO:
            self._met_server(wire.server_info(content))
        elif message == wire.DESCRIPTIONS and self._info is not None:
            self._described = wire.descriptions(content, self._info.version)
            self._choose()
        elif message == wire.FRAME and self._info is not None:
            frame = wire.frame(content, self._info.version)
            self._frames, self._unread, self._heard_s = self._frames + 1, "", self._clock.monotonic_s()
            if frame.changed or (self._actor is not None and self._actor_id not in frame.skeletons):
                self._send(wire.REQUEST_DESCRIPTIONS)
            return self._time_ns(frame, self._info), frame
        return None

    def _met_server(self, info: wire.ServerInfo) -> None:
        if info.version not in wire.VERSIONS:
            known = ", ".join(f"{major}.{minor}" for major, minor in wire.VERSIONS)
            raise DeviceError(
                f"natnet: {info.application} speaks NatNet {info.version[0]}.{info.version[1]}; understood: {known}; "
                "set one of them as its bitstream version"
            )
        if info != self._info:
            self._info, self._described, self._actor = info, None, None
            self._send(wire.REQUEST_DESCRIPTIONS)

    def _choose(self) -> None:
        """Choose the actor of those that are described."""
        self._actor, self._why_not = None, ""
        described = self._described or ()
        named = ", ".join(skeleton.name for skeleton in described)[:200]
        chosen = [skeleton for skeleton in described if self._wanted in ("", skeleton.name)]
        if len(chosen) != 1:
            missing = f"no actor {self._wanted!r} there" if self._wanted else "no actor there"
            several = f"{len(chosen)} actors there: {named}; name one with actor=…"
            self._why_not = several if chosen else f"{missing}, but {named or 'none at all'}; switch on Skeletons"
            return
        try:
            self._actor, self._actor_id = Actor(chosen[0]), chosen[0].id
        except NotAPerson as error:
            self._why_not = str(error)

    @staticmethod
    def _time_ns(frame: wire.Frame, info: wire.ServerInfo) -> int:
        has_ticks = frame.exposed and info.ticks_hz
        time_ns = frame.exposed * 1_000_000_000 // info.ticks_hz if has_ticks else round(frame.time_s * 1e9)
        if time_ns > _MOST_NS:
            raise wire.BadPacket(f"frame {frame.number} is of tick {frame.exposed}")
        return time_ns

    def _is_later(self, time_ns: int) -> bool:
        return time_ns > self._newest_ns or time_ns < self._newest_ns - _BACK_NS

    def _body(self, actor: Actor, time_ns: int, frame: wire.Frame) -> Body | None:
        bones = frame.skeletons.get(self._actor_id)
        if bones is None:
            return None
        now = bones[["position", "quat_xyzw"]].tobytes()
        if now != self._bones or time_ns < self._still_since_ns:
            self._bones, self._still_since_ns = now, time_ns
        return None if time_ns - self._still_since_ns > _STILL_NS else actor.body(bones)


def _opened(address: str, port: int, *, join_on: str = "") -> socket.socket:
    """Return a socket that never blocks, bound to an address alone; a member of that group where it is one."""
    with contextlib.ExitStack() as undo:
        made = undo.enter_context(contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)))
        made.setblocking(False)
        if join_on:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # others may listen to the group as well
        made.bind((address, port))
        if join_on:
            member = struct.pack("4s4s", socket.inet_aton(address), socket.inet_aton(join_on))
            made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        undo.pop_all()
    return made
