"""A camera's optics: how a point before it becomes a pixel, and where it is mounted.

Axes of a camera are those of OpenCV, ROS and Foxglove: x to the right in the picture, y down, z forward. The centre of
a pixel has whole numbers as coordinates, that of the first one (0, 0).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import msgspec

Distortion = Literal["none", "plumb_bob", "rational_polynomial", "kannala_brandt"]
"""As ROS and Foxglove call the models: OpenCV's of 5 and of 8 coefficients, and its fisheye model."""

_COEFFICIENTS: dict[Distortion, tuple[int, ...]] = {
    "none": (0,), "plumb_bob": (4, 5), "rational_polynomial": (8,), "kannala_brandt": (4,),
}  # fmt: skip
_UNIT = 1e-3  # a quaternion may differ from length 1 by so much: files have few digits
_OPENGL = "x right, y up, z backward"


class Intrinsics(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a point before a camera becomes a pixel, for pictures of one size.

    Attributes:
        width, height: Size of the pictures that these numbers are for [px].
        fx, fy: Focal lengths [px].
        cx, cy: Principal point [px].
        distortion: Model of the lens.
        coefficients: The model's: plumb_bob k1 k2 p1 p2 k3, rational_polynomial k1 k2 p1 p2 k3 k4 k5 k6,
            kannala_brandt k1 k2 k3 k4.
        source: Where they are from.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = "none"
    coefficients: tuple[float, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        for name, size in (("width", self.width), ("height", self.height)):
            if size < 1:
                raise ValueError(
                    f"{name} is {size}; expected the size of the pictures that the intrinsics are for [px]"
                )
        for name, focal in (("fx", self.fx), ("fy", self.fy)):
            if not 0.0 < focal < math.inf:
                raise ValueError(f"{name} is {focal:g}; expected a focal length above 0 px")
        for name, centre, size in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if not -0.5 <= centre <= size - 0.5:
                raise ValueError(
                    f"{name} is {centre:g}, outside of a picture of {size} px; are the intrinsics of another size?"
                )
        expected = _COEFFICIENTS[self.distortion]
        if len(self.coefficients) not in expected or not all(map(math.isfinite, self.coefficients)):
            count = " or ".join(map(str, expected))
            raise ValueError(
                f"coefficients are {list(self.coefficients)}; {self.distortion} has {count} finite numbers"
            )

    @property
    def matrix(self) -> tuple[float, ...]:
        """The camera matrix K, row by row, 3x3 [px]."""
        return self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0

    @property
    def projection(self) -> tuple[float, ...]:
        """The projection matrix P of a single camera that was not rectified, row by row, 3x4 [px]."""
        return self.fx, 0.0, self.cx, 0.0, 0.0, self.fy, self.cy, 0.0, 0.0, 0.0, 1.0, 0.0

    @property
    def lens(self) -> tuple[str, tuple[float, ...]]:
        """Model and coefficients as readers of calibrations take them: plumb_bob of zeros for no distortion."""
        name, wanted = ("plumb_bob", 5) if self.distortion in ("none", "plumb_bob") else (self.distortion, 0)
        return name, (*self.coefficients, *[0.0] * (wanted - len(self.coefficients)))


class Mount(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a camera is, in a frame that it is fixed to.

    Attributes:
        parent: The frame: a body of the robot's model, or ``world``.
        position_m: Of the camera in it [m].
        quat_wxyz: Turns the camera's axes (x right, y down, z forward) into those of the frame.
    """

    parent: str
    position_m: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        if not self.parent:
            raise ValueError("parent is empty; expected the frame that the camera is fixed to, or world")
        if not all(map(math.isfinite, self.position_m)):
            raise ValueError(f"position_m is {list(self.position_m)}; expected three finite numbers [m]")
        length = math.hypot(*self.quat_wxyz)
        if not abs(length - 1.0) <= _UNIT:
            raise ValueError(f"quat_wxyz has length {length:g}; expected a rotation as w x y z, of length 1")


class Optics(NamedTuple):
    """What is known of a camera; None for nothing."""

    intrinsics: Intrinsics | None = None
    mount: Mount | None = None

    def facts(self) -> dict[str, Any]:
        """Return it as a server states it: members ``intrinsics`` and ``mount`` of its facts, where there are any."""
        return {name: msgspec.to_builtins(one) for name, one in self._asdict().items() if one is not None}


def from_opengl(quat_wxyz: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the rotation of a camera whose own was given for OpenGL's and MuJoCo's axes: y up, z backward."""
    w, x, y, z = quat_wxyz
    return -x, w, z, -y


def of_facts(facts: Mapping[str, Any]) -> Optics:
    """Return what a server states of its camera.

    Raises:
        ValueError: it states something else; one line.
    """
    intrinsics, mount = facts.get("intrinsics"), facts.get("mount")
    if isinstance(intrinsics, dict):  # of before, without the size: it is that of the pictures
        intrinsics = {"width": facts.get("width"), "height": facts.get("height"), **intrinsics}
    if isinstance(mount, dict) and mount.get("frame") == _OPENGL:  # of before, in MuJoCo's axes
        quat = mount.get("quat_wxyz")
        turned = from_opengl(quat) if isinstance(quat, list) and len(quat) == 4 else quat
        mount = {"parent": mount.get("body"), "position_m": mount.get("position_m"), "quat_wxyz": turned}
    return Optics(_as("intrinsics", intrinsics, Intrinsics), _as("mount", mount, Mount))


def _as(name: str, value: object, kind: type[Any]) -> Any:
    try:
        return None if value is None else msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise ValueError(f"{name}: {error}") from None
