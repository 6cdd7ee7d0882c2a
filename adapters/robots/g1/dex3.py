"""Unitree's Dex3-1 hands in place of the rubber ones, in the model of a G1 (`adapters.robots.legged.models`).

Masses and frames are facts of ``g1_29dof_with_hand_rev_1_0`` in unitreerobotics/unitree_rl_gym (BSD-3-Clause). Numbers
are those of the left hand; the right one is its mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element, SubElement

from adapters.robots.g1.joints import DEX3_LEFT, DEX3_RIGHT
from adapters.robots.legged.table import Joint

Side = Literal["left", "right"]
Vector = tuple[float, float, float]
Quat = tuple[float, float, float, float]

_JOINTS: dict[Side, tuple[Joint, ...]] = {"left": DEX3_LEFT, "right": DEX3_RIGHT}
_AXES = {"y": "0 1 0", "z": "0 0 1"}


@dataclass(frozen=True, slots=True)
class _Inertia:
    mass_kg: float
    com: Vector
    quat_wxyz: Quat
    principal: Vector

    def element(self, side: Side) -> Element:
        # A mirror in the plane y = 0 turns the other way about x and z.
        signs = (1, 1, 1, 1) if side == "left" else (1, -1, 1, -1)
        quat = [sign * value for sign, value in zip(signs, self.quat_wxyz, strict=True)]
        return Element(
            "inertial", pos=_text(_mirror(self.com, side)), quat=_text(quat),
            mass=_text([self.mass_kg]), diaginertia=_text(self.principal),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Finger:
    """A link of the left hand: it is a capsule from its joint, which is at its origin, to `tip`."""

    parent: str
    position: Vector
    inertia: _Inertia
    tip: Vector
    radius: float


_PALM = _Inertia(
    0.457415, (0.0885506, 0.00212216, -0.000374562), (0.487149, 0.493844, 0.513241, 0.505358),
    (0.00105989, 0.000895419, 0.000323842),
)  # fmt: skip
_THUMB_0 = _Inertia(
    0.0862366, (-0.000884246, -0.00863407, 0.000944293), (0.462991, 0.643965, -0.460173, 0.398986),
    (1.6546e-05, 1.60058e-05, 1.43741e-05),
)  # fmt: skip
_THUMB_1 = _Inertia(
    0.0588507, (-0.000827888, -0.0354744, -0.0003809), (0.685598, 0.705471, -0.15207, 0.0956069),
    (1.28514e-05, 1.22902e-05, 5.9666e-06),
)  # fmt: skip
_THUMB_2 = _Inertia(
    0.0203063, (-0.00171735, -0.0262819, 0.000107789), (0.703174, 0.710977, -0.00017564, -0.00766553),
    (4.61314e-06, 3.86645e-06, 1.53495e-06),
)  # fmt: skip
_FINGER_0 = _Inertia(
    0.0588507, (0.0354744, 0.000827888, 0.0003809), (0.391313, 0.552395, 0.417187, 0.606373),
    (1.28514e-05, 1.22902e-05, 5.9666e-06),
)  # fmt: skip
_FINGER_1 = _Inertia(
    0.0203063, (0.0262819, 0.00171735, -0.000107789), (0.502612, 0.491799, 0.502639, 0.502861),
    (4.61314e-06, 3.86645e-06, 1.53495e-06),
)  # fmt: skip
_FINGERS = {
    "thumb_0": _Finger("", (0.067, 0.003, 0), _THUMB_0, (0, -0.012, 0), 0.017),
    "thumb_1": _Finger("thumb_0", (-0.0025, -0.0193, 0), _THUMB_1, (0, -0.0458, 0), 0.011),
    "thumb_2": _Finger("thumb_1", (0, -0.0458, 0), _THUMB_2, (0, -0.042, 0), 0.0095),
    "middle_0": _Finger("", (0.1192, 0.0046, -0.0285), _FINGER_0, (0.0458, 0, 0), 0.011),
    "middle_1": _Finger("middle_0", (0.0458, 0, 0), _FINGER_1, (0.042, 0, 0), 0.0095),
    "index_0": _Finger("", (0.1192, 0.0046, 0.0285), _FINGER_0, (0.0458, 0, 0), 0.011),
    "index_1": _Finger("index_0", (0.0458, 0, 0), _FINGER_1, (0.042, 0, 0), 0.0095),
}


def give_hands(root: Element) -> None:
    """Put the hands into the parsed model of a G1; its motors and its keyframe are another's."""
    for side, joints in _JOINTS.items():
        _give_hand(_only(root, f".//body[@name='{side}_wrist_yaw_link']"), side, joints)


def _give_hand(wrist: Element, side: Side, joints: tuple[Joint, ...]) -> None:
    for old in wrist.findall("geom"):
        wrist.remove(old)
    wrist.remove(_only(wrist, "inertial"))
    wrist.insert(0, _PALM.element(side))
    geoms = (
        {"class": f"{side}_arm", "fromto": _text((0.05, 0, 0, 0.1, 0, 0)), "size": "0.025"},
        {"type": "cylinder", "fromto": _text((0, 0, -0.028, 0, 0, 0.028)), "size": "0.018", "material": "metal"},
        {"fromto": _text((0.01, 0, 0, 0.05, 0, 0)), "size": "0.024"},
        {"type": "box", "pos": "0.084 0 0", "size": "0.034 0.02 0.04", "material": "dark"},
    )
    for index, geom in enumerate(geoms):
        wrist.insert(2 + index, Element("geom", geom))  # after inertia and joint
    bodies = {"": wrist}
    for joint, (name, finger) in zip(joints, _FINGERS.items(), strict=True):
        frame = {"name": f"{joint.name}_link", "pos": _text(_mirror(finger.position, side))}
        bodies[name] = SubElement(bodies[finger.parent], "body", frame)
        bodies[name].extend(_parts(joint, finger, side))


def _parts(joint: Joint, finger: _Finger, side: Side) -> list[Element]:
    shape = {"fromto": _text((0, 0, 0, *_mirror(finger.tip, side))), "size": _text([finger.radius])}
    return [
        finger.inertia.element(side),
        Element("joint", {
            "name": joint.mjcf_name, "axis": _AXES[joint.axis], "range": _text((joint.lower, joint.upper)),
            "armature": _text([joint.armature]), "frictionloss": "0",
            "actuatorfrcrange": _text((-joint.effort_nm, joint.effort_nm)),
        }),
        # Fingers touch the ground and things, not the robot: with its servo at zero a thumb points at the thigh.
        Element("geom", {"class": "limb", **shape}),
        Element("geom", {**shape, "material": "metal" if joint.name.endswith("_0") else "dark"}),
    ]  # fmt: skip


def _mirror(vector: Vector, side: Side) -> Vector:
    x, y, z = vector
    return (x, y, z) if side == "left" else (x, -y, z)


def _text(numbers: Sequence[float]) -> str:
    return " ".join(f"{number + 0.0:.9g}" for number in numbers)  # + 0.0: no minus before a zero


def _only(root: Element, path: str) -> Element:
    (found,) = root.findall(path)
    return found
