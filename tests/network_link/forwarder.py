"""The process between network namespaces: it has a TAP device in each, and carries frames from one to all others.

Run as a file, with the standard library alone: ``forwarder.py CONTROL SETTINGS``, a socket's number and JSON. It makes
the namespaces and says where they are; then it answers requests, one JSON object each, until the socket is closed.
When it ends, so do the namespaces once nobody is in them.

A frame of a loss is drawn when it comes; its delay too, from a normal distribution that ends at zero. No frame
overtakes another of its direction: behind a late one all are late, as on a radio that sends again.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import heapq
import json
import os
import random
import select
import signal
import socket
import struct
import sys
import time
from typing import Any

_CLONE_NEWNET = 0x40000000  # linux/sched.h
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_TUNSETIFF, _TUNSETCARRIER = 0x400454CA, 0x400454E2  # linux/if_tun.h
_IFF_TAP, _IFF_NO_PI = 0x0002, 0x1000
_SIOCGIFFLAGS, _SIOCSIFFLAGS, _SIOCSIFADDR, _SIOCSIFNETMASK = 0x8913, 0x8914, 0x8916, 0x891C  # linux/sockios.h
_IFF_UP = 0x1
_LONGEST_FRAME = 2048
_AT_ONCE = 64
_PRIORITY = 70  # of SCHED_FIFO, above whatever runs at the ends: a cable is not busy


class Direction:
    """What comes out of one end.

    Args:
        tap: Of that end.
        seed: Of losses and delays.
    """

    def __init__(self, tap: int, seed: int) -> None:
        self.tap = tap
        self.delay_s = self.jitter_s = self.loss = 0.0
        self.chance = random.Random(seed)
        self.newest_due_s = 0.0
        self.came = self.delivered = self.lost = self.cut = 0
        self.last_ns = 0  # when the newest datagram for the watched port was delivered

    def due_s(self, now_s: float) -> float:
        """Return when a frame that comes now is delivered; not before one that came earlier."""
        delay_s = self.delay_s
        if self.jitter_s:
            delay_s = max(0.0, self.chance.gauss(delay_s, self.jitter_s))
        self.newest_due_s = max(self.newest_due_s, now_s + delay_s)
        return self.newest_due_s

    def counts(self) -> dict[str, int]:
        return {name: getattr(self, name) for name in ("came", "delivered", "lost", "cut", "last_ns")}


class Forwarder:
    """The cable.

    Args:
        directions: All ends.
        port: UDP port that is watched.
    """

    def __init__(self, directions: list[Direction], port: int) -> None:
        self._directions, self._port = directions, struct.pack("!H", port)
        self._on_the_way: list[tuple[float, int, int, bytes]] = []
        self._is_in = True
        self._count = 0

    def run(self, control: socket.socket) -> None:
        """Carry frames until the control socket is closed."""
        numbers = {direction.tap: number for number, direction in enumerate(self._directions)}
        watched = [*numbers, control.fileno()]
        while True:
            wait_s = max(0.0, self._on_the_way[0][0] - time.monotonic()) if self._on_the_way else None
            ready = select.select(watched, [], [], wait_s)[0]
            for descriptor in ready:
                if descriptor in numbers:
                    self._take(numbers[descriptor])
                elif not (asked := control.recv(65536)):
                    return
                else:
                    control.send(json.dumps(self._obey(json.loads(asked))).encode())
            self._deliver()

    def _take(self, number: int) -> None:
        direction = self._directions[number]
        with contextlib.suppress(BlockingIOError):
            for _ in range(_AT_ONCE):
                frame = os.read(direction.tap, _LONGEST_FRAME)
                direction.came += 1
                if not self._is_in:
                    direction.cut += 1
                elif direction.loss and direction.chance.random() < direction.loss:
                    direction.lost += 1
                else:
                    self._count += 1
                    due_s = direction.due_s(time.monotonic())
                    heapq.heappush(self._on_the_way, (due_s, self._count, number, frame))

    def _deliver(self) -> None:
        while self._on_the_way and self._on_the_way[0][0] <= time.monotonic():
            _, _, number, frame = heapq.heappop(self._on_the_way)
            direction = self._directions[number]
            if frame[12:14] == b"\x08\x00" and frame[23] == socket.IPPROTO_UDP and self._is_watched(frame):
                direction.last_ns = time.monotonic_ns()
            for other in self._directions:
                with contextlib.suppress(BlockingIOError):  # nobody takes it there: lost, as anywhere
                    if other is not direction:
                        os.write(other.tap, frame)
                        direction.delivered += 1

    def _is_watched(self, frame: bytes) -> bool:
        begin = 14 + 4 * (frame[14] & 0x0F)
        return frame[begin + 2 : begin + 4] == self._port

    def _obey(self, asked: dict[str, Any]) -> dict[str, Any]:
        for number, values in asked.get("ways", {}).items():
            for name, value in values.items():
                setattr(self._directions[int(number)], name, float(value))
        at_ns = 0
        if "is_in" in asked:
            self._is_in = asked["is_in"]
            if not self._is_in:
                for _, _, number, _ in self._on_the_way:
                    self._directions[number].cut += 1
                self._on_the_way.clear()
            for number in asked["carrier_at"]:
                fcntl.ioctl(self._directions[number].tap, _TUNSETCARRIER, struct.pack("i", self._is_in))
            at_ns = time.monotonic_ns()
        return {"at_ns": at_ns, "counts": [direction.counts() for direction in self._directions]}


def make_end(libc: Any, interface: str, address: str, bits: int) -> tuple[int, int]:
    """Make a namespace with loopback and one Ethernet device; return the device and the namespace as descriptors."""
    if libc.unshare(_CLONE_NEWNET) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    with contextlib.suppress(OSError), open("/proc/sys/net/ipv6/conf/all/disable_ipv6", "w") as switch:
        switch.write("1")  # else each end greets its routers: frames that no test sent
    tap = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    fcntl.ioctl(tap, _TUNSETIFF, struct.pack("16sH22x", interface.encode(), _IFF_TAP | _IFF_NO_PI))
    mask = socket.inet_ntoa(struct.pack("!I", 0xFFFFFFFF << (32 - bits) & 0xFFFFFFFF))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for request, ip in ((_SIOCSIFADDR, address), (_SIOCSIFNETMASK, mask)):
            of_address = struct.pack("HH4s8x", socket.AF_INET, 0, socket.inet_aton(ip))
            fcntl.ioctl(any_socket, request, struct.pack("16s16s8x", interface.encode(), of_address))
        for name in ("lo", interface):
            request = struct.pack("16sH22x", name.encode(), 0)
            (flags,) = struct.unpack("16xH22x", fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request))
            fcntl.ioctl(any_socket, _SIOCSIFFLAGS, struct.pack("16sH22x", name.encode(), flags | _IFF_UP))
    return tap, os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)


def main(number: str, settings: str) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal: who made the cable takes it away
    wanted = json.loads(settings)
    control = socket.socket(fileno=int(number))
    try:
        ends = [make_end(libc, wanted["interface"], address, wanted["bits"]) for address in wanted["addresses"]]
    except OSError as error:
        control.send(json.dumps({"failed": f"{error.strerror} ({error.filename or 'network namespace'})"}).encode())
        return
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    gc.disable()
    directions = [Direction(tap, wanted["seed"] + place) for place, (tap, _) in enumerate(ends)]
    control.send(json.dumps({"namespaces": [f"/proc/{os.getpid()}/fd/{held}" for _, held in ends]}).encode())
    with contextlib.suppress(ConnectionError):
        Forwarder(directions, wanted["port"]).run(control)


if __name__ == "__main__":
    main(*sys.argv[1:])
