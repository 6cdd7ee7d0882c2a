"""A camera's optics: what is refused, and what servers of before stated."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from station import rotations
from station.config import build
from station.errors import ConfigError
from station.optics import Intrinsics, Mount, Optics, from_opengl, of_facts

GOOD: dict[str, Any] = {"width": 640, "height": 480, "fx": 600.0, "fy": 601.0, "cx": 319.5, "cy": 240.0}
MOUNT: dict[str, Any] = {"parent": "torso_link", "position_m": [0.1, 0.0, 0.4], "quat_wxyz": [0.5, -0.5, 0.5, -0.5]}


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"width": 0}, "width is 0; expected the size of the pictures"),
        ({"fx": -1.0}, "fx is -1; expected a focal length above 0 px"),
        ({"fy": float("nan")}, "fy is nan; expected a focal length above 0 px"),
        ({"cx": 960.0}, "cx is 960, outside of a picture of 640 px; are the intrinsics of another size?"),
        ({"cy": -3.0}, "cy is -3, outside of a picture of 480 px"),
        ({"distortion": "plumb_bob", "coefficients": [0.1]}, r"coefficients are \[0.1\]; plumb_bob has 4 or 5"),
        ({"coefficients": [0.1] * 5}, "none has 0 finite numbers"),
        ({"distortion": "fisheye"}, "fisheye"),
        ({"k1": 0.1}, "k1"),
    ],
)
def test_intrinsics_that_cannot_be_are_refused_in_a_line(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told) as caught:
        build(Intrinsics, {**GOOD, **wrong}, where="head")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"parent": ""}, "parent is empty"),
        ({"position_m": [0.0, float("inf"), 0.0]}, "expected three finite numbers"),
        ({"quat_wxyz": [1.0, 1.0, 0.0, 0.0]}, "quat_wxyz has length 1.41421; expected a rotation as w x y z"),
        ({"quat_wxyz": [1.0, 0.0, 0.0]}, "quat_wxyz"),
    ],
)
def test_a_mount_that_cannot_be_is_refused_in_a_line(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build(Mount, {**MOUNT, **wrong}, where="head")


def test_what_a_server_states_is_read_back() -> None:
    optics = Optics(Intrinsics(**GOOD), msgspec.convert(MOUNT, Mount))
    assert of_facts(optics.facts()) == optics
    assert of_facts({"fps": 30}) == Optics()
    assert Optics().facts() == {}
    assert optics.intrinsics is not None
    assert optics.intrinsics.matrix == (600.0, 0.0, 319.5, 0.0, 601.0, 240.0, 0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match=r"intrinsics: .*fx"):
        of_facts({"width": 640, "height": 480, "intrinsics": {"fx": "wide"}})


def test_what_stations_of_version_0_1_stated_has_the_same_meaning() -> None:
    """Without a size, and a mount in MuJoCo's axes: what is up there is down here, what is behind is before."""
    quat = rotations.normalized([0.3, 0.4, -0.5, 0.6]).tolist()
    inner = {name: GOOD[name] for name in ("fx", "fy", "cx", "cy")} | {"distortion": "none", "source": "exact"}
    mount = {"body": "torso_link", "position_m": [0.1, 0.0, 0.4], "quat_wxyz": quat,
             "frame": "x right, y up, z backward"}  # fmt: skip
    found = of_facts({"width": 640, "height": 480, "intrinsics": inner, "mount": mount})
    assert found.intrinsics == Intrinsics(**GOOD, source="exact")
    assert found.mount is not None
    assert (found.mount.parent, found.mount.position_m) == ("torso_link", (0.1, 0.0, 0.4))
    for ours, theirs in (([1, 0, 0], [1, 0, 0]), ([0, 1, 0], [0, -1, 0]), ([0, 0, 1], [0, 0, -1])):
        np.testing.assert_allclose(
            rotations.rotate(found.mount.quat_wxyz, ours), rotations.rotate(quat, theirs), atol=1e-12
        )
    assert from_opengl(quat) == pytest.approx(found.mount.quat_wxyz)
