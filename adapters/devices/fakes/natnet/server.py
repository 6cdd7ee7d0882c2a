"""The fake's server: it answers requests and sends 120 frames a second to every client of the last five seconds."""

from __future__ import annotations

import contextlib
import errno
import itertools
import socket
import threading
import time
from pathlib import Path
from typing import Any, Literal

import click
import numpy as np
from numpy.typing import NDArray

from adapters.devices.fakes import script
from adapters.devices.fakes.natnet import packets, person
from adapters.devices.fakes.punctual import be_punctual
from adapters.devices.natnet import wire
from adapters.retarget.human import of_height, standing
from adapters.retarget.skeleton import skeletons as skeletons_of
from station import registry
from station.operator.device import DeviceError
from station.protocols import Motion
from station.stop_signals import set_on_signals

Fault = Literal["", "silence", "freeze", "still", "untracked", "no-actor", "cut", "too-many"]

HEIGHT_M = 1.75
_RATE_HZ = 120.0
_FORGETS_S = 5.0
_TREMBLE_M = 1e-5
_HOST = "127.0.0.1"


class Step(script.Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A step of a script.

    Attributes:
        motion: What the actor does from then on; None for what was done before.
        fault: What is wrong from then on, "" for nothing; None for what was wrong before.
    """

    motion: str | None = None
    fault: Fault | None = None


class FakeMotive:
    """Listens from its construction on.

    Args:
        file: The script.
        port: UDP port on 127.0.0.1; 0 takes a free one.
        version: Of NatNet.
        is_local: Whether bones are in their parents' frames, or in the world.
        group: Multicast group that frames go to, with its port; None for each client by itself.
        actors: Names of those who are described; they all do the same.

    Attributes:
        port: The port it listens on.

    Raises:
        BadFile: the script cannot be read, or names a motion that cannot.
        DeviceError: the port is in use.
    """

    def __init__(
        self,
        file: Path,
        port: int = 0,
        *,
        version: wire.Version = (4, 1),
        is_local: bool = True,
        group: tuple[str, int] | None = None,
        actors: tuple[str, ...] = (person.NAME,),
    ) -> None:
        played = script.load(file, "natnet", Step)
        names = {step.motion for step in played.steps if step.motion}
        self._takes: dict[str, NDArray[Any]] = {name: _taken(name, is_local=is_local) for name in ("", *sorted(names))}
        self._play = script.Play(played)
        self._version, self._group, self._actors = version, group, actors
        self._lengths = of_height(HEIGHT_M)
        self._motion, self._motion_at_s = "", 0.0
        self._fault: Fault = ""
        self._fault_at_s = 0.0
        self._clients: dict[tuple[str, int], float] = {}
        self._stop = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((_HOST, port))
        except OSError as error:
            self._socket.close()
            what = "is in use, maybe by Motive" if error.errno == errno.EADDRINUSE else f"is none: {error.strerror}"
            raise DeviceError(f"UDP port {port} on {_HOST} {what}; take another with --port N") from None
        if group:
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(_HOST))
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._run, name="fake-motive", daemon=True)
        self._thread.start()

    def begin(self, start_s: float = 0.0) -> None:
        """Let the script begin, at a time of its own [s]."""
        self._play.begin(start_s)

    def close(self) -> None:
        """Be gone; a second call does nothing."""
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        be_punctual()
        began_s = time.monotonic()
        for number in itertools.count():
            if self._stop.wait(max(began_s + number / _RATE_HZ - time.monotonic(), 0.0)):
                return
            self._answer()
            self._follow_script()
            if (data := self._frame(number)) is not None:
                for client in self._targets():
                    self._send(data, client)

    def _answer(self) -> None:
        while True:
            try:
                data, client = self._socket.recvfrom(4096)
            except OSError:  # nothing more; or a client that is gone
                return
            self._clients[client] = time.monotonic()
            message = int.from_bytes(data[:2], "little")
            if message == wire.CONNECT:
                group, port = self._group or ("", 0)
                self._send(packets.server_info(self._version, port, group), client)
            elif message == wire.REQUEST_DESCRIPTIONS:
                skeletons = (
                    person.described(self._lengths, name, person.ID + index) for index, name in enumerate(self._actors)
                )
                self._send(packets.descriptions(tuple(skeletons), self._version), client)

    def _follow_script(self) -> None:
        if not self._play.has_begun:
            return
        for at_s, step in self._play.due(self._play.time_s()):
            if step.motion is not None:
                self._motion, self._motion_at_s = step.motion, at_s
            if step.fault is not None:
                self._fault, self._fault_at_s = step.fault, at_s

    def _frame(self, number: int) -> bytes | None:
        if self._fault == "silence":
            return None
        time_s = self._play.time_s() if self._play.has_begun else 0.0
        is_held = self._fault in ("freeze", "still", "untracked")
        bones = self._bones(self._fault_at_s if is_held else time_s)
        if self._fault == "untracked":
            bones["flags"] = 0
        elif self._fault not in ("freeze", "still"):
            bones["position"] += _TREMBLE_M * (number % 2)
        skeletons = {} if self._fault == "no-actor" else {
            id_: _of_skeleton(bones, id_) for id_ in range(person.ID, person.ID + len(self._actors))
        }  # fmt: skip
        stamp_s = 1.0 + (self._fault_at_s if self._fault == "freeze" else number / _RATE_HZ)
        data = packets.frame(number, skeletons, stamp_s, self._version)
        if self._fault == "cut":
            return data[: len(data) // 2]
        if self._fault == "too-many":
            begin, count = person.ID.to_bytes(4, "little"), len(person.BONES).to_bytes(4, "little")
            return data.replace(begin + count, begin + (1_000_000).to_bytes(4, "little"))
        return data

    def _bones(self, time_s: float) -> NDArray[Any]:
        take = self._takes[self._motion]
        number = round((time_s - self._motion_at_s) * _RATE_HZ) % (2 * len(take))
        return np.copy(take[min(number, 2 * len(take) - 1 - number)])

    def _targets(self) -> list[tuple[str, int]]:
        now_s = time.monotonic()
        self._clients = {client: heard_s for client, heard_s in self._clients.items() if now_s - heard_s < _FORGETS_S}
        return [self._group] if self._group else list(self._clients)

    def _send(self, data: bytes, client: tuple[str, int]) -> None:
        with contextlib.suppress(OSError):  # a client that is gone, or takes no more: datagrams are lost
            self._socket.sendto(data, client)


def _taken(motion: str, *, is_local: bool) -> NDArray[Any]:
    """Return all frames of an actor who does a motion, or stands; slow, so they are made before the server starts."""
    lengths = of_height(HEIGHT_M)
    if not motion:
        body = standing(lengths, arms="down")
        return person.seen(body.positions[None], body.quats_wxyz[None], is_local=is_local)
    found: Motion = registry.find("loader", "motion")(motion)
    times_s = np.arange(0.0, found.duration_s, 1.0 / _RATE_HZ)
    done = [found.at(float(time_s)) for time_s in times_s]
    root_pos, quats, q = (
        np.stack([getattr(each, name) for each in done]) for name in ("root_pos", "root_quat_wxyz", "q")
    )
    return person.seen(*skeletons_of(root_pos, quats, q, lengths), is_local=is_local)


def _of_skeleton(bones: NDArray[Any], id_: int) -> NDArray[Any]:
    rows = bones.copy()
    rows["id"] += id_ << 16
    return rows


def run_for_person(file: Path, port: int) -> None:
    """Play a script until Ctrl-C; raises as `FakeMotive`."""
    stop = threading.Event()
    set_on_signals(stop)
    with contextlib.closing(FakeMotive(file, port)) as fake:
        setting = "" if fake.port == wire.COMMAND_PORT else f" with --set natnet.port={fake.port}"
        click.echo(f"a fake Motive at {_HOST}:{fake.port} for a natnet server{setting}; Ctrl-C takes it away", err=True)
        fake.begin()
        stop.wait()
