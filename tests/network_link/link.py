"""A cable between computers that are all on this machine: delay, jitter, loss, and a hand that pulls it.

::

    with Link(("192.168.123.164", "192.168.123.222"), seed=1) as link:
        robot, operator = link.ends
        robot.popen([sys.executable, "-m", "http.server"])
        link.change(delay_s=0.005, jitter_s=0.01, loss=0.01)
        link.pull()
        link.plug()

Each end is a network namespace with loopback and one Ethernet device, so that ARP, multicast and TCP are the kernel's
own; a process of ours carries frames from each to all others (`tests.network_link.forwarder`), as a hub does where
there are more than two. All ends share CLOCK_MONOTONIC, so one-way times are exact, and the file system: a unix socket
with a path is heard from any end without the cable. Needs root; nothing is left when the test is killed.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, Self

from tests.network_link import enter, forwarder

INTERFACE = "eno1"
"""Of either end, as a computer calls the first of its sockets."""

_TUN = Path("/dev/net/tun")
_ANSWERS_S = 20.0


class LinkFailed(OSError):
    """The kernel makes no such cable here."""


class Counts(NamedTuple):
    """Frames of one direction.

    Attributes:
        came: That were sent.
        delivered: That reached another end, once for each.
        lost: By chance.
        cut: Because the cable was not in, those that were on the way when it was pulled too.
        last_ns: When the newest datagram for the watched port was delivered [ns, monotonic]; 0 for never.
    """

    came: int
    delivered: int
    lost: int
    cut: int
    last_ns: int


class End:
    """A computer at an end.

    Args:
        number: Place in `Link.ends`.
        address: Of its Ethernet device.
        namespace: A path that names its network namespace while the link is there, for ``nsenter --net=PATH`` too.
    """

    def __init__(self, number: int, address: str, namespace: str) -> None:
        self.number, self.address, self.namespace = number, address, namespace

    @property
    def prefix(self) -> tuple[str, ...]:
        """What a command line begins with, so that it runs there; killed with the thread that starts it."""
        return (sys.executable, "-I", "-S", enter.__file__, self.namespace)

    def socket(self, kind: socket.SocketKind = socket.SOCK_DGRAM) -> socket.socket:
        """Return an IPv4 socket of that computer, for whoever asks: a socket stays where it was made."""

        def make() -> socket.socket:
            enter.enter(self.namespace)  # of this thread alone
            return socket.socket(socket.AF_INET, kind)

        with ThreadPoolExecutor(1) as thread:
            return thread.submit(make).result()

    def popen(self, words: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
        """Start a command there; `options` as of `subprocess.Popen`."""
        return subprocess.Popen([*self.prefix, *words], **options)


class Link:
    """A context manager.

    Args:
        addresses: Of the ends, in one network of 24 bits.
        interface: Name of the Ethernet device of each end.
        port: UDP port that is watched, see `Counts.last_ns`; 0 for none.
        seed: Of losses and delays.

    Raises:
        LinkFailed: on entering, where this user may not, or this kernel cannot.
    """

    def __init__(self, addresses: Sequence[str], *, interface: str = INTERFACE, port: int = 0, seed: int = 0) -> None:
        self._addresses = addresses
        self._settings = {"addresses": list(addresses), "bits": 24, "interface": interface, "port": port, "seed": seed}
        self._carrier_at: list[int] = []

    def __enter__(self) -> Self:
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.settimeout(_ANSWERS_S)
        with theirs:
            command = [sys.executable, "-I", "-S", forwarder.__file__, str(theirs.fileno()), json.dumps(self._settings)]
            self._forwarder = subprocess.Popen(command, pass_fds=(theirs.fileno(),), stdin=subprocess.DEVNULL)
        try:
            said = self._hear()
        except BaseException:
            self.close()
            raise
        if "failed" in said:
            self.close()
            raise LinkFailed(said["failed"])
        found = zip(self._addresses, said["namespaces"], strict=True)
        self.ends = tuple(End(number, address, path) for number, (address, path) in enumerate(found))
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Take it away; what runs at its ends has loopback alone from then on."""
        self._control.close()
        try:
            self._forwarder.wait(_ANSWERS_S)
        except subprocess.TimeoutExpired:
            self._forwarder.kill()
            self._forwarder.wait()

    def change(
        self, *, delay_s: float = 0.0, jitter_s: float = 0.0, loss: float = 0.0, out_of: End | None = None
    ) -> None:
        """Have another line from now on; what is on the way already arrives as it would have.

        Args:
            delay_s, jitter_s: Mean and standard deviation of the one-way delay, before frames wait for earlier ones.
            loss: Share of frames that is lost, 0 to 1.
            out_of: The only end whose frames are meant; None for all.
        """
        way = {"delay_s": delay_s, "jitter_s": jitter_s, "loss": loss}
        numbers = range(len(self.ends)) if out_of is None else (out_of.number,)
        self._ask({"ways": {str(number): way for number in numbers}})

    def pull(self, *at: End) -> int:
        """Pull the cable; what is on the way is lost. Return when [ns, monotonic].

        Args:
            at: Ends that see no carrier from then on, as where the plug is pulled; none of them where it was pulled
                behind a switch.
        """
        self._carrier_at = [end.number for end in at]
        return int(self._ask({"is_in": False, "carrier_at": self._carrier_at})["at_ns"])

    def plug(self) -> None:
        """Put it back."""
        self._ask({"is_in": True, "carrier_at": self._carrier_at})

    def counts(self, out_of: End) -> Counts:
        """Return what became of the frames of an end so far."""
        return Counts(**self._ask({})["counts"][out_of.number])

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        self._control.send(json.dumps(request).encode())
        return self._hear()

    def _hear(self) -> dict[str, Any]:
        if not (said := self._control.recv(65536)):
            raise LinkFailed("the process between the two ends has ended")
        found: dict[str, Any] = json.loads(said)
        return found


def why_not() -> str:
    """Return why no cable can be made here, or ""."""
    if os.geteuid() != 0:
        return "only root makes network namespaces, and two computers with a cable between them need two"
    if not _TUN.exists():
        return f"there is no {_TUN}, and a cable between two network namespaces needs one"
    try:
        with Link(("10.0.0.1", "10.0.0.2")):
            return ""
    except LinkFailed as error:
        return f"no cable between two network namespaces can be made here: {error}"
