"""A lidar's topics on this machine without a lidar: a simulated room, sent as the robot's service sends it.

Run: ``python -m adapters.lidars.dds_room --interface lo --domain 1``; Ctrl-C ends it. Needs the extra ``g1``.
"""

from __future__ import annotations

import argparse
import threading
import time

from adapters.lidars import dds_types
from adapters.lidars.options import DdsOptions
from adapters.lidars.room import FRAME, POINTS, RATE_HZ, Room
from adapters.lidars.ros_messages import Imu, write_cloud, write_imu
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import NetworkOptions
from station.stop_signals import set_on_signals

_IMU_PER_CLOUD = 20


def send(network: Network, room: Room, stop: threading.Event, options: DdsOptions, clouds: int | None = None) -> int:
    """Send clouds ten times a second, and the IMU beside them, until asked to stop; return how many.

    Args:
        network: Where to.
        room: What is seen.
        stop: Ends it.
        options: Names of the topics.
        clouds: How many; None for no end.
    """
    writer = network.writer(options.cloud, raw(dds_types.PointCloud2))
    imu_writer = network.writer(options.imu, raw(dds_types.Imu))
    start_s, period_s, ticks, sent = time.monotonic(), 1.0 / (RATE_HZ * _IMU_PER_CLOUD), 0, 0
    while (clouds is None or sent < clouds) and not stop.is_set():
        gyro, acceleration = (tuple(values.tolist()) for values in room.imu())
        imu_writer.write(write_imu(Imu(gyro, acceleration, time.time_ns()), FRAME))
        if ticks % _IMU_PER_CLOUD == 0:
            writer.write(write_cloud(room.cloud(time.time_ns())))
            sent += 1
        ticks += 1
        stop.wait(max(0.0, start_s + ticks * period_s - time.monotonic()))
    return sent


def main() -> None:
    """Send until Ctrl-C."""
    parser = argparse.ArgumentParser(description="A simulated lidar on DDS.")
    parser.add_argument("--interface", default="lo", help="network interface (default: lo)")
    parser.add_argument("--domain", type=int, default=0, help="DDS domain (default: 0)")
    parser.add_argument("--points", type=int, default=POINTS, help=f"points of each cloud (default: {POINTS})")
    given = parser.parse_args()
    stop = threading.Event()
    set_on_signals(stop)
    with Network(NetworkOptions(interface=given.interface, domain=given.domain)) as network:
        send(network, Room(given.points), stop, DdsOptions())


if __name__ == "__main__":
    main()
