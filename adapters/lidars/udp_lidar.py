"""A Livox lidar's datagrams, heard and never asked for: nothing is sent to the lidar.

A lidar sends to one host. To make it send to this one takes its stream from the robot's own service, so a robot's lidar
is read over DDS first.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Sequence
from typing import Any

from adapters.lidars.livox_packets import IMU, Packet, cloud_of, imu_of, parse
from adapters.lidars.options import UdpOptions
from adapters.lidars.room import FIELDS, FRAME
from station.camera.source import Drops
from station.lidar.source import ImuSample, LidarError, Scan
from station.point_cloud import BadCloud

_BUFFER_BYTES = 4 << 20
_LARGEST = 2048  # of a datagram
_TOGETHER_S = 0.005  # packets of so long are read in one go
_MOST_PACKETS = 20_000  # in one look, and in one cloud
_A_FRAME_OF_LOST = 1000  # a larger step of the count is no loss, but another start
_G = 9.80665


class UdpLidar:
    """Hears a lidar; implements `station.lidar.source.Lidar`.

    Args:
        options: Where it sends to. What was lost is counted in packets.

    Raises:
        LidarError: this machine has no such address, or another program has the port.
    """

    def __init__(self, options: UdpOptions) -> None:
        self.drops = Drops()
        self._options, self._period_ns = options, round(1e9 / options.rate_hz)
        self._packets: list[Packet] = []
        self._number: int | None = None
        self._why_not = ""
        self._has_come = False
        self._points = _bound(options.address, options.point_port)
        try:
            self._imu = _bound(options.address, options.imu_port)
        except LidarError:
            self._points.close()
            raise

    def read(self, timeout_s: float) -> Scan | None:
        """Return the newest cloud whose time is full; see `Lidar.read`."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0:
            if not select.select([self._points], [], [], left_s)[0]:
                return None
            time.sleep(min(_TOGETHER_S, left_s))
            if (scan := self._collected()) is not None:
                return scan
        return None

    def imu(self) -> Sequence[ImuSample]:
        """Return the samples that have come; when each was taken, by the sensor's time before the newest one."""
        packets = [packet for packet in self._arrived(self._imu) if packet.type == IMU]
        now_ns, found = time.monotonic_ns(), []
        for packet in packets:
            try:
                values = imu_of(packet)
            except BadCloud as error:
                self._refuse(error)
                continue
            age_ns = max(0, packets[-1].sensor_ns - packet.sensor_ns)
            found.append(ImuSample((*values[:3], *(_G * value for value in values[3:])), now_ns - age_ns))
        return found

    def why_silent(self) -> str:
        """Return what is wrong with what comes, or that nothing does."""
        where = f"{self._options.address}:{self._options.point_port}"
        return self._why_not or f"{where}: nothing comes; does the lidar send to this host and port?"

    def facts(self) -> dict[str, Any]:
        """Return where it is heard, and the layout that points are brought into."""
        return {
            "device": f"udp {self._options.address}:{self._options.point_port}",
            "frame": FRAME if self._has_come else None,
            "fields": [field._asdict() for field in FIELDS] if self._has_come else None,
            "fps": self._options.rate_hz,
            "capture": "arrival of the last packet; the sensor's own time stands in the cloud",
            "converted": "integers to metres, packets to one cloud",
        }

    def close(self) -> None:
        """Hear no more."""
        self._points.close()
        self._imu.close()

    def _collected(self) -> Scan | None:
        """Take what has come; return the newest frame that is full by now."""
        scan = None
        for packet in self._arrived(self._points):
            if packet.type == IMU:
                continue
            self._count_lost(packet.number)
            first = self._packets[0] if self._packets else packet
            is_within = 0 <= packet.sensor_ns - first.sensor_ns < self._period_ns
            if not is_within or len(self._packets) >= _MOST_PACKETS:
                self.drops.skipped += scan is not None
                scan = Scan(cloud_of(self._packets), time.monotonic_ns())
                self._packets = []
            self._packets.append(packet)
        if scan is not None:
            self._has_come, self._why_not = True, ""
        return scan

    def _arrived(self, heard: socket.socket) -> list[Packet]:
        found = []
        for _ in range(_MOST_PACKETS):
            try:
                data, (sender, _) = heard.recvfrom(_LARGEST)
            except BlockingIOError:
                break
            if self._options.lidar not in ("", sender):
                continue
            try:
                found.append(parse(data))
            except BadCloud as error:
                self._refuse(error)
        return found

    def _count_lost(self, number: int) -> None:
        step = 0 if self._number is None or number == 0 else number - self._number - 1
        self.drops.lost += step if 0 < step < _A_FRAME_OF_LOST else 0
        self._number = number

    def _refuse(self, error: BadCloud) -> None:
        self.drops.torn += 1
        self._why_not = f"{self._options.address}: {error}"


def _bound(address: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        made.bind((address, port))
    except OSError as error:
        made.close()
        raise LidarError(
            f"{address}:{port}: {error.strerror or error}; expected an address of this machine and a port that no "
            "other program has; `ip -br address` lists addresses"
        ) from None
    made.setblocking(False)
    return made
