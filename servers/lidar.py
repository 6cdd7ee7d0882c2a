"""The lidar server: point clouds of one lidar on the bus, as its sensor gave them, and its IMU beside them.

One process per lidar. What a lidar is, an adapter knows (`adapters.lidars`, found by the setting `source`). A runbook
starts it like a camera:

    - start: top
      server: lidar
      with: {source: dds, options: {interface: eno1}}

It moves nothing, so it may be started again by itself, and it stands back behind whatever else this machine does.
"""

from __future__ import annotations

import os
import re
from typing import Annotated, Any

import msgspec

from station import config as configs
from station import libraries, registry, rotations
from station.config import to_plain
from station.lidar.serve import serve_lidar
from station.lidar.source import LidarKind
from station.life.server import Life, ServerKind
from station.optics import Mount

_NAME = re.compile(r"[a-z0-9_]+")
_BYTES_PER_S = 5.2e6  # 20,000 points of 26 bytes, ten times a second


class LidarMount(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a lidar is fixed.

    Attributes:
        parent: What it is fixed to: a body of the robot's model, or ``world``.
        position_m: Of the sensor in it [m].
        rpy_rad: Roll, pitch and yaw of the sensor's axes in it, about fixed x, y, z in that order [rad].
    """

    parent: str
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        self.as_mount()

    def as_mount(self) -> Mount:
        """Return it with a rotation.

        Raises:
            ValueError: it is none.
        """
        w, x, y, z = rotations.from_roll_pitch_yaw(self.rpy_rad).tolist()
        return Mount(parent=self.parent, position_m=self.position_m, quat_wxyz=(w, x, y, z))


class LidarConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the lidar server.

    Attributes:
        source: Where the clouds come from: ``dds``, ``udp``, ``rays``, or as it is registered.
        options: The source's.
        name: Of the lidar, in its keys ``lidar_cloud_NAME`` and ``lidar_imu_NAME``; "" for the server's own name.
        mount: Where it is fixed: parent (a body of the robot, or ``world``), position_m, rpy_rad; None leaves clouds in
            the sensor's own frame.
        niceness: How far the process stands back behind others, 0 to 19: clouds may wait, a robot may not.
    """

    source: Annotated[str, registry.named("lidar")] = "dds"
    options: dict[str, Any] = {}
    name: str = ""
    mount: LidarMount | None = None
    niceness: int = 5

    def __post_init__(self) -> None:
        registry.expect("lidar", self.source)
        if self.name and not _NAME.fullmatch(self.name):
            raise ValueError(f"name is {self.name!r}; expected small letters, digits and _, for example top")
        if not 0 <= self.niceness <= 19:
            raise ValueError(f"niceness is {self.niceness}; expected 0 to 19")
        self.typed_options()

    @property
    def kind(self) -> LidarKind:
        """The kind of its source."""
        found: LidarKind = registry.find("lidar", self.source)
        return found

    @property
    def option_types(self) -> dict[str, type[msgspec.Struct]]:
        """Types of the settings that are mappings, by name."""
        return {"options": self.kind.options}

    def typed_options(self) -> Any:
        """Return the options as the source's type has them.

        Raises:
            ValueError: they are none of its options; the message names the field.
        """
        return configs.build_options(self.kind.options, self.options, where=f"options of the source {self.source}")

    def cloud_bytes_per_s(self) -> float:
        """Return about how much its clouds need [bytes/s]."""
        return _BYTES_PER_S


def main(config: LidarConfig, life: Life) -> int:
    """Publish clouds until asked to stop; return the exit code."""
    kind, options = config.kind, config.typed_options()
    os.nice(config.niceness)
    life.bus.open_bulk()  # so that one that is not there is told now
    mount = None if config.mount is None else config.mount.as_mount()
    return serve_lidar(
        life,
        lambda: kind.open(options),
        name=config.name or life.name,
        facts={"source": config.source, "config": to_plain(config)},
        mount=mount,
    )


KIND = ServerKind(
    name="lidar",
    role="sensor",
    summary="point clouds of a lidar: over DDS, its own packets, or simulated",
    config=LidarConfig,
    main=main,
    expect=lambda config: libraries.expect(f"lidar source {config.source}", config.kind.library, config.kind.extra),
)
