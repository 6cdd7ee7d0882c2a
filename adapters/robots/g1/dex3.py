"""Makes ``g1_dex3.xml`` from ``g1.xml``: Unitree's Dex3-1 hands in place of the rubber ones.

``python -m adapters.robots.g1.dex3`` writes the file anew. Masses, frames, ranges and efforts are facts of
``g1_29dof_with_hand_rev_1_0`` in unitreerobotics/unitree_rl_gym (BSD-3-Clause). Numbers are those of the left hand;
the right one is its mirror image. The motors' order is that of the Dex3's own messages, and differs between the sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, XMLParser, fromstring, indent, tostring

Side = Literal["left", "right"]
Vector = tuple[float, float, float]
Quat = tuple[float, float, float, float]

_HERE = Path(__file__).parent
SOURCE, TARGET = _HERE / "g1.xml", _HERE / "g1_dex3.xml"

MOTORS: dict[Side, tuple[str, ...]] = {
    "left": ("thumb_0", "thumb_1", "thumb_2", "middle_0", "middle_1", "index_0", "index_1"),
    "right": ("thumb_0", "thumb_1", "thumb_2", "index_0", "index_1", "middle_0", "middle_1"),
}
"""The joints of each hand in the order of its motors."""

_HEAD = (
    """ Unitree G1 with 29 joints and two Dex3-1 hands. Made from g1.xml by dex3.py: change those, not this file. """
)

# Gains with which a Dex3 is usually held. Damping is the joint's and not the servo's, because Euler integrates it
# implicitly: a finger is too light for an explicit one at 2 ms. No source gives an armature: this one is ours, chosen
# well above a finger's own inertia so that the servo stays stable.
_KP, _KD, _ARMATURE = 1.5, 0.1, 0.001


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
    """A link of the left hand: its joint is at its origin, it is a capsule from there to `tip`, 0 thick for none."""

    name: str
    parent: str
    position: Vector
    inertia: _Inertia
    axis: Literal["y", "z"]
    lower: float
    upper: float
    tip: Vector
    radius: float
    effort_nm: float = 1.4


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
_FINGERS = (
    _Finger("thumb_0", "", (0.067, 0.003, 0), _THUMB_0, "y", -1.0472, 1.0472, (0, -0.012, 0), 0.017, 2.45),
    _Finger("thumb_1", "thumb_0", (-0.0025, -0.0193, 0), _THUMB_1, "z", -0.724312, 1.0472, (0, -0.0458, 0), 0.011),
    _Finger("thumb_2", "thumb_1", (0, -0.0458, 0), _THUMB_2, "z", 0, 1.74533, (0, -0.042, 0), 0.0095),
    _Finger("middle_0", "", (0.1192, 0.0046, -0.0285), _FINGER_0, "z", -1.5708, 0, (0.0458, 0, 0), 0.011),
    _Finger("middle_1", "middle_0", (0.0458, 0, 0), _FINGER_1, "z", -1.74533, 0, (0.042, 0, 0), 0.0095),
    _Finger("index_0", "", (0.1192, 0.0046, 0.0285), _FINGER_0, "z", -1.5708, 0, (0.0458, 0, 0), 0.011),
    _Finger("index_1", "index_0", (0.0458, 0, 0), _FINGER_1, "z", -1.74533, 0, (0.042, 0, 0), 0.0095),
)


def build(source: str) -> str:
    """Return the text of ``g1_dex3.xml``, made of the text of ``g1.xml``."""
    root = fromstring(source, parser=XMLParser(target=TreeBuilder(insert_comments=True)))
    root.set("model", "g1_dex3")
    root[0].text = _HEAD
    _add_class(_only(root, "default"))
    for side in ("left", "right"):
        _give_hand(_only(root, f".//body[@name='{side}_wrist_yaw_link']"), side)
        _add_motors(_only(root, "actuator"), side)
    key = _only(root, "keyframe/key")
    qpos = key.get("qpos", "").split()
    # Joints are in the order of the tree: each hand follows the seven joints of its arm.
    key.set("qpos", " ".join([*qpos[:-7], *["0"] * 7, *qpos[-7:], *["0"] * 7]))
    key.set("ctrl", " ".join([*key.get("ctrl", "").split(), *["0"] * 14]))
    indent(root, "  ")
    return tostring(root, encoding="unicode") + "\n"


def main() -> None:
    """Write the file."""
    TARGET.write_text(build(SOURCE.read_text(encoding="utf-8")), encoding="utf-8")


def _add_class(defaults: Element) -> None:
    fingers = SubElement(defaults, "default", {"class": "finger"})
    SubElement(fingers, "joint", damping=_text([_KD]), armature=_text([_ARMATURE]), frictionloss="0")
    SubElement(fingers, "position", kp=_text([_KP]))


def _give_hand(wrist: Element, side: Side) -> None:
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
    for finger in _FINGERS:
        bodies[finger.name] = SubElement(bodies[finger.parent], "body", _frame(finger, side))
        bodies[finger.name].extend(_parts(finger, side))


def _frame(finger: _Finger, side: Side) -> dict[str, str]:
    return {"name": f"{side}_hand_{finger.name}_link", "pos": _text(_mirror(finger.position, side))}


def _parts(finger: _Finger, side: Side) -> list[Element]:
    lower, upper = finger.lower, finger.upper
    if side == "right" and finger.axis == "z":
        lower, upper = -upper, -lower
    joint = {"name": _joint(side, finger.name), "class": "finger", "range": _text((lower, upper))}
    if finger.axis == "y":
        joint["axis"] = "0 1 0"
    joint["actuatorfrcrange"] = _text((-finger.effort_nm, finger.effort_nm))
    shape = {"fromto": _text((0, 0, 0, *_mirror(finger.tip, side))), "size": _text([finger.radius])}
    return [
        finger.inertia.element(side),
        Element("joint", joint),
        # Fingers touch the ground and things, not the robot: with its servo at zero a thumb points at the thigh.
        Element("geom", {"class": "limb", **shape}),
        Element("geom", {**shape, "material": "metal" if finger.name.endswith("_0") else "dark"}),
    ]


def _add_motors(actuators: Element, side: Side) -> None:
    efforts = {finger.name: finger.effort_nm for finger in _FINGERS}
    for name in MOTORS[side]:
        joint, limit = _joint(side, name), efforts[name]
        settings = {"class": "finger", "forcerange": _text((-limit, limit))}
        SubElement(actuators, "position", {"name": joint, "joint": joint, **settings})


def _joint(side: Side, name: str) -> str:
    return f"{side}_hand_{name}_joint"


def _mirror(vector: Vector, side: Side) -> Vector:
    x, y, z = vector
    return (x, y, z) if side == "left" else (x, -y, z)


def _text(numbers: Sequence[float]) -> str:
    return " ".join(f"{number + 0.0:.9g}" for number in numbers)  # + 0.0: no minus before a zero


def _only(root: Element, path: str) -> Element:
    (found,) = root.findall(path)
    return found


if __name__ == "__main__":
    main()
