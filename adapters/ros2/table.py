"""The table of the ROS 2 bridge: which key of the bus is which topic. It is a YAML file; docs/ros2.md shows one."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Literal

import msgspec

from station import assets, config

Published = Literal[
    "joint-state", "imu", "twist", "twist-stamped", "transform", "compressed-image", "point-cloud", "float32-array",
    "diagnostics", "clock",
]  # fmt: skip
Heard = Literal["twist", "twist-stamped", "joint-state", "float32-array"]

TYPES: dict[str, str] = {
    "joint-state": "sensor_msgs/msg/JointState",
    "imu": "sensor_msgs/msg/Imu",
    "twist": "geometry_msgs/msg/Twist",
    "twist-stamped": "geometry_msgs/msg/TwistStamped",
    "transform": "tf2_msgs/msg/TFMessage",
    "compressed-image": "sensor_msgs/msg/CompressedImage",
    "point-cloud": "sensor_msgs/msg/PointCloud2",
    "float32-array": "std_msgs/msg/Float32MultiArray",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "clock": "rosgraph_msgs/msg/Clock",
}
"""ROS 2's type of each kind of message."""

STALE_S = 0.25
"""What is older moves no robot, unless its row says otherwise [s]; the gate of a robot here says the same."""

_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_DRIVES = ("twist", "twist-stamped")


class Qos(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Quality of service of a topic.

    Attributes:
        depth: Messages kept for one that is late.
        reliability: A reliable subscription hears no best-effort publisher; best effort hears both.
        durability: ``transient_local`` gives the newest also to those who come later.
    """

    depth: int = 10
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"

    def __post_init__(self) -> None:
        if not 1 <= self.depth <= 1000:
            raise ValueError(f"depth is {self.depth}; expected 1 to 1000 messages")


class Joints(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a topic has the joints: position on the bus = offset + scale x position in ROS.

    Attributes:
        names: As the station calls them, in the topic's order.
        called: As ROS calls them; none for the same.
        offset: Of each [rad]; none for 0.
        scale: What a position of 1 in ROS is [rad].
        velocity_scale: What a velocity of 1 in ROS is [rad/s].
    """

    names: tuple[str, ...]
    called: tuple[str, ...] = ()
    offset: tuple[float, ...] = ()
    scale: float = 1.0
    velocity_scale: float = 1.0

    def __post_init__(self) -> None:
        for what, given in (("called", self.called), ("offset", self.offset)):
            if given and len(given) != len(self.names):
                raise ValueError(f"joints: {what} has {len(given)} entries, names has {len(self.names)}")
        for what, twice in (("names", self.names), ("called", self.called)):
            if len({*twice}) < len(twice):
                raise ValueError(f"joints: {what} has one twice")
        if not self.names or not all(map(math.isfinite, self.offset)):
            raise ValueError("joints: expected one name or more, and finite offsets")
        for what, scale in (("scale", self.scale), ("velocity_scale", self.velocity_scale)):
            if not (math.isfinite(scale) and scale):
                raise ValueError(f"joints: {what} is {scale:g}; expected a number other than 0")

    @property
    def ros_names(self) -> tuple[str, ...]:
        """As ROS calls them."""
        return self.called or self.names

    @property
    def offsets(self) -> tuple[float, ...]:
        """Of each [rad]."""
        return self.offset or (0.0,) * len(self.names)


class PublishRow(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"kind": "as"}):
    """A topic that the station publishes.

    Attributes:
        topic: Its name.
        kind: What its messages are; ``as`` in the file.
        key: Of the bus, of which each new value is a message.
        frame: Of the header, and the child of a ``transform``, whose parent is ``world``.
        joints: How it has the joints; all that the key has, in its order and in SI units, where it is not said.
        acceleration: What an ``imu`` says of it: what was measured, or which way is down, as a unit vector.
        max_age_s: A value that was written longer ago is not published [s]; 0 for any age.
        zero_after_s: After so long without a value a ``twist`` of zeros is published [s], also where the station is
            gone; 0 for never.
        qos: Quality of service.
    """

    topic: str
    kind: Published
    key: str
    frame: str = "base_link"
    joints: Joints | None = None
    acceleration: Literal["measured", "down"] = "measured"
    max_age_s: float = 0.0
    zero_after_s: float | None = None
    qos: Qos = Qos()

    def __post_init__(self) -> None:
        _expect_topic(self.topic)
        if not self.key.strip() or self.key.endswith("@"):
            raise ValueError(f"{self.topic}: key is {self.key!r}; expected one that `station keys` lists")
        _expect_kind(self.topic, self.kind, "joints", self.joints is not None, ("joint-state",))
        _expect_kind(self.topic, self.kind, "acceleration", self.acceleration != "measured", ("imu",))
        _expect_kind(self.topic, self.kind, "zero_after_s", self.zero_after_s is not None, _DRIVES)
        _expect_seconds(self.topic, "max_age_s", self.max_age_s)
        _expect_seconds(self.topic, "zero_after_s", self.zero_after_s or 0.0)

    @property
    def drives(self) -> bool:
        """Whether what hears it may move by it."""
        return self.kind in _DRIVES

    @property
    def longest_s(self) -> float:
        """A value that was written longer ago is not published [s]."""
        return self.max_age_s or (STALE_S if self.drives else math.inf)

    @property
    def ends_after_s(self) -> float:
        """After how long without a value zeros are published [s]; 0 for never."""
        return (0.3 if self.drives else 0.0) if self.zero_after_s is None else self.zero_after_s


class SubscribeRow(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"kind": "as"}):
    """A topic that the station hears, as commands of a robot.

    Attributes:
        topic: Its name.
        kind: What its messages are; ``as`` in the file.
        command: Registered name of the command's format.
        robot: End of the robot's keys, for a format that is for any.
        joints: How it has the joints; those of the command, in SI units, where it is not said.
        stamp: By which time a message is how old: its header's (that of its publisher where it has none, or zero), its
            publisher's, or none, where clocks do not agree: then only its arrival counts.
        max_age_s: A message that is older is refused [s].
        qos: Quality of service.
    """

    topic: str
    kind: Heard
    command: str
    robot: str = ""
    joints: Joints | None = None
    stamp: Literal["header", "publisher", "none"] = "header"
    max_age_s: float = STALE_S
    qos: Qos = Qos()

    def __post_init__(self) -> None:
        _expect_topic(self.topic)
        _expect_kind(self.topic, self.kind, "joints", self.joints is not None, ("joint-state",))
        _expect_seconds(self.topic, "max_age_s", self.max_age_s)
        if not self.max_age_s:
            raise ValueError(f"{self.topic}: max_age_s is 0; expected more, or stamp: none")


class Services(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Services that the station answers; one without a name is not there.

    Attributes:
        arm: ``std_srvs/SetBool``: arms or disarms, as `station arm` does.
        engage: ``std_srvs/SetBool``: lets commands of ROS through, or holds them back.
        zero: ``std_srvs/Trigger``: holds commands of ROS back, so that the robot goes back to how it stands.
        server: Name of the low-level server that is armed; "" for every one.
    """

    arm: str = ""
    engage: str = ""
    zero: str = ""
    server: str = ""

    def __post_init__(self) -> None:
        for name in self.names.values():
            _expect_topic(name)

    @property
    def names(self) -> dict[str, str]:
        """Those that are there, by what they do."""
        return {what: name for what in ("arm", "engage", "zero") if (name := getattr(self, what))}


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the file says."""

    publish: tuple[PublishRow, ...] = ()
    subscribe: tuple[SubscribeRow, ...] = ()
    services: Services = Services()

    def __post_init__(self) -> None:
        if not (self.publish or self.subscribe or self.services.names):
            raise ValueError("it has no row; expected publish, subscribe or services")
        heard = {row.topic.lstrip("/") for row in self.subscribe}
        if both := [row.topic for row in self.publish if row.topic.lstrip("/") in heard]:
            raise ValueError(f"{both[0]} is published and heard: it would hear itself; leave out one of the two rows")


def read(reference: str) -> Table:
    """Read a table, a path or ``collection:path``.

    Raises:
        StationError: there is none, or it is none.
    """
    path: Path = assets.resolve(reference)
    return config.build(Table, config.read_yaml(path), where=str(path))


def _expect_topic(name: str) -> None:
    if not _TOPIC.fullmatch(name) or "__" in name:
        raise ValueError(f"{name!r} is no name of a topic or service; expected one such as /cmd_vel")


def _expect_kind(topic: str, kind: str, what: str, is_said: bool, kinds: tuple[str, ...]) -> None:
    if is_said and kind not in kinds:
        raise ValueError(f"{topic}: {what} is for {' and '.join(kinds)}; it is {kind}")


def _expect_seconds(topic: str, what: str, value: float) -> None:
    if not (0.0 <= value < math.inf):
        raise ValueError(f"{topic}: {what} is {value:g}; expected seconds, 0 or more")
