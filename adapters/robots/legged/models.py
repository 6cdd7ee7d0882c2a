"""Makes the mesh-free models of robots on legs, and the files by which they stand, from the tables.

``python -m adapters.robots.legged.models`` writes them anew. Masses, inertias and link frames are facts of
unitreerobotics/unitree_rl_gym (Go2, H1-2, G1 with 12 joints), of mujoco_menagerie (Go1, H1) and of unitree_ros (G1 with
23 joints), all BSD-3-Clause; shapes are ours. Numbers are those of the left, and of a quadruped's front; the other side
is their mirror image. The G1s are `g1.xml` with fewer joints, or with hands; light, floor and materials of all are from
there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, XMLParser, fromstring, indent, tostring

from adapters.robots.g1.dex3 import give_hands
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import G1_12, G1_23, G1_DEX3, GO1, GO2, H1, H1_2, H1_2_12, H1_10, ROBOTS

HERE = Path(__file__).parent
SOURCE = HERE.parent / "g1" / "g1.xml"

Vector = tuple[float, ...]
Shape = dict[str, str]

_UNIT = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
_AHEAD = "0 -1 0 0 0 1"  # axes of a camera that looks along x


@dataclass(frozen=True, slots=True)
class Link:
    """A body: where it is in its parent's frame, what it weighs, the joint at its origin, and its shapes.

    Attributes:
        joint: Name in the robot's table; "" for one that floats. Where the table has none, it is fixed to its parent.
        position: Of its origin [m].
        turned: Quaternion wxyz of its frame.
        com: Centre of its mass [m].
        axes: Quaternion wxyz of the axes of its inertia.
        inertia: About them [kg m^2].
        is_mirrored: Whether the inertia of the other side is the mirror image; a part built in twice is not mirrored.
    """

    name: str
    parent: str
    joint: str
    position: Vector
    mass_kg: float
    com: Vector
    axes: Vector
    inertia: Vector
    shapes: tuple[Shape, ...] = ()
    turned: Vector = (1, 0, 0, 0)
    is_mirrored: bool = True


def _text(numbers: Iterable[float]) -> str:
    return " ".join(f"{number + 0.0:.9g}" for number in numbers)  # + 0.0: no minus before a zero


def _look(kind: str, size: Vector, material: str = "shell", **places: Vector) -> Shape:
    return {"type": kind, **{name: _text(at) for name, at in places.items()}, "size": _text(size), "material": material}


def _touch(size: Vector, kind: str = "capsule", **places: Vector) -> Shape:
    return {"class": "limb", "type": kind, **{name: _text(at) for name, at in places.items()}, "size": _text(size)}


def _sole(*corners: Vector) -> tuple[Shape, ...]:
    return tuple({"class": "sole", "pos": _text(corner)} for corner in corners)


def _rod(radius: float, start: Vector, end: Vector, material: str = "shell", kind: str = "capsule") -> Shape:
    return _look(kind, (radius,), material, fromto=(*start, *end))


def _other_side(link: Link, names: tuple[str, str], plane: Vector = (1, -1, 1)) -> Link:
    """Return the mirror image of a link; the plane has one -1."""

    def point(vector: Vector) -> Vector:
        return tuple(sign * value for sign, value in zip(plane, vector, strict=True))

    def rotation(quat: Vector) -> Vector:  # turns the other way about the axes that lie in the plane
        return (quat[0], *(-sign * value for sign, value in zip(plane, quat[1:], strict=True)))

    def shape(old: Shape) -> Shape:
        places = {name: [float(word) for word in old[name].split()] for name in ("pos", "fromto") if name in old}
        ends = {name: [tuple(at[i : i + 3]) for i in range(0, len(at), 3)] for name, at in places.items()}
        return old | {name: " ".join(_text(point(end)) for end in found) for name, found in ends.items()}

    come = {name: getattr(link, name).replace(*names) for name in ("name", "parent", "joint")}
    return replace(
        link, **come, position=point(link.position), turned=rotation(link.turned),
        com=point(link.com) if link.is_mirrored else link.com,
        axes=rotation(link.axes) if link.is_mirrored else link.axes,
        shapes=tuple(shape(each) for each in link.shapes),
    )  # fmt: skip


def _both_sides(links: tuple[Link, ...]) -> Iterator[Link]:
    """Yield links, those of the left followed by those of the right limb."""
    limb: list[Link] = []
    for link in (*links, None):
        if link is not None and link.name.startswith("left_"):
            if limb and link.parent not in {each.name for each in limb}:  # another limb of the left begins
                yield from _with_right(limb)
                limb = []
            limb.append(link)
            continue
        yield from _with_right(limb)
        limb = []
        if link is not None:
            yield link


def _with_right(limb: list[Link]) -> Iterator[Link]:
    yield from limb
    yield from (_other_side(link, ("left_", "right_")) for link in limb)


def _corners(leg: tuple[Link, ...], order: tuple[str, ...]) -> Iterator[Link]:
    """Yield the legs of a quadruped; `leg` is the front left one. The hips of the rear are turned about."""
    for corner in order:
        for link in leg:
            made = replace(
                link, **{name: getattr(link, name).replace("FL", corner) for name in ("name", "parent", "joint")}
            )
            if corner[0] == "R" and made.name.endswith("_hip"):
                made = _other_side(made, ("", ""), (-1, 1, 1))
            yield _other_side(made, ("", "")) if corner[1] == "R" else made


_GO2_TRUNK = Link(
    "base", "", "", (0, 0, 0), 6.921, (0.021112, 0, -0.005366),
    (-0.000543471, 0.713435, -0.00173769, 0.700719), (0.107027, 0.0980771, 0.0244531),
    (
        _touch((0.188, 0.047, 0.057), "box"), _touch((0.05,), "sphere", pos=(0.28, 0, 0)),
        _look("box", (0.19, 0.07, 0.045)), _rod(0.05, (-0.16, -0.035, 0.012), (0.17, -0.035, 0.012)),
        _rod(0.05, (-0.16, 0.035, 0.012), (0.17, 0.035, 0.012)),
        _look("box", (0.15, 0.055, 0.03), "dark", pos=(0, 0, -0.03)),
        _look("ellipsoid", (0.075, 0.052, 0.05), pos=(0.265, 0, 0.012)),
        _look("ellipsoid", (0.03, 0.047, 0.028), "visor", pos=(0.318, 0, 0.012)),
        _look("sphere", (0.014,), "glow", pos=(0.335, 0, 0.02)),
        _look("sphere", (0.042,), "dark", pos=(0.289, 0, -0.047)),
    ),
)  # fmt: skip


def _leg(
    *, hip: Vector, side_m: float, links: tuple[tuple[float, Vector, Vector, Vector], ...], foot_radius_m: float,
    foot_mass_kg: float,
) -> tuple[Link, ...]:  # fmt: skip
    """Return the front left leg of a quadruped whose thigh and shank are 0.213 m long.

    Args:
        hip: Of the first joint in the trunk [m].
        side_m: From the first joint to the second.
        links: Mass, centre of mass, axes and moments of inertia of hip, thigh and calf.
        foot_radius_m, foot_mass_kg: Of the foot; without a mass of its own it is a part of the calf.
    """
    foot: Vector = (0, 0, -0.213)
    shank = (
        _touch((0.012,), fromto=(0.004, 0, -0.02, 0.014, 0, -0.15)),
        _rod(0.019, (0, 0, 0), (0.012, 0, -0.06)), _rod(0.013, (0.012, 0, -0.06), (0.012, 0, -0.13), "dark"),
        _rod(0.012, (0.012, 0, -0.13), foot, "dark"),
    )  # fmt: skip
    ball = ({"class": "sole", "size": _text((foot_radius_m,))}, _look("sphere", (foot_radius_m,), "metal"))
    found = (
        Link("FL_hip", "", "FL_hip", hip, *links[0], (
            _touch((0.046,), "sphere", pos=(0, side_m - 0.015, 0)),
            _rod(0.04, (-0.045, 0, 0), (0.045, 0, 0), "dark", "cylinder"),
            _rod(0.046, (0, side_m - 0.055, 0), (0, side_m - 0.012, 0), "metal", "cylinder"),
        )),
        Link("FL_thigh", "FL_hip", "FL_thigh", (0, side_m, 0), *links[1], (
            _touch((0.02,), fromto=(0, 0, -0.02, 0, 0, -0.19)),
            _rod(0.046, (0, -0.012, 0), (0, 0.02, 0), "dark", "cylinder"),
            _look("ellipsoid", (0.042, 0.022, 0.085), pos=(-0.008, 0, -0.06)),
            _rod(0.02, (-0.006, 0, -0.1), (0, 0, -0.205)),
        )),
        Link("FL_calf", "FL_thigh", "FL_calf", foot, *links[2], shank),
    )  # fmt: skip
    if foot_mass_kg:
        return (
            *found,
            Link("FL_foot", "FL_calf", "", foot, foot_mass_kg, (0, 0, 0), (1, 0, 0, 0), (9.6e-6,) * 3, ball),
        )
    placed = tuple(shape | {"pos": _text(foot)} for shape in ball)
    return (*found[:2], replace(found[2], shapes=(*shank, *placed), is_mirrored=False))  # as upstream has a Go1's


_GO2_LEG = _leg(
    hip=(0.1934, 0.0465, 0), side_m=0.0955, foot_radius_m=0.022, foot_mass_kg=0.04,
    links=(
        (0.678, (-0.0054, 0.00194, -0.000105), (0.497014, 0.499245, 0.505462, 0.498237),
         (0.00088403, 0.000596003, 0.000479967)),
        (1.152, (-0.00374, -0.0223, -0.0327), (0.829533, 0.0847635, -0.0200632, 0.551623),
         (0.00594973, 0.00584149, 0.000878787)),
        (0.154, (0.00548, -0.000975, -0.115), (0.715503, -0.00296114, -0.00858043, 0.698551),
         (0.00110008, 0.00108027, 3.25534e-05)),
    ),
)  # fmt: skip

_GO1_TRUNK = Link(
    "trunk", "", "", (0, 0, 0), 5.204, (0.0223, 0.002, -0.0005),
    (-0.00342088, 0.705204, 0.000106698, 0.708996), (0.0716565, 0.0630105, 0.0168101),
    (
        _touch((0.125, 0.04, 0.057), "box"), _touch((0.058,), fromto=(-0.125, -0.04, 0, 0.125, -0.04, 0)),
        _touch((0.058,), fromto=(-0.125, 0.04, 0, 0.125, 0.04, 0)), _touch((0.05,), "sphere", pos=(0.27, 0, 0)),
        _rod(0.055, (-0.15, -0.04, 0.004), (0.15, -0.04, 0.004)),
        _rod(0.055, (-0.15, 0.04, 0.004), (0.15, 0.04, 0.004)),
        _look("box", (0.16, 0.05, 0.05)), _look("box", (0.1, 0.03, 0.012), "dark", pos=(0, 0, 0.058)),
        _look("box", (0.045, 0.05, 0.042), "dark", pos=(0.235, 0, 0)),
        _look("ellipsoid", (0.022, 0.048, 0.036), "visor", pos=(0.282, 0, 0.002)),
        _look("sphere", (0.009,), "metal", pos=(0.3, 0.025, 0.008)),
        _look("sphere", (0.009,), "metal", pos=(0.3, -0.025, 0.008)),
    ),
)  # fmt: skip

_GO1_LEG = _leg(
    hip=(0.1881, 0.04675, 0), side_m=0.08, foot_radius_m=0.023, foot_mass_kg=0,
    links=(
        (0.68, (-0.0049166, -0.00762615, -8.865e-05), (0.482891, 0.495027, 0.514169, 0.507341),
         (0.000734064, 0.000468438, 0.000398719)),
        (1.009, (-0.00304722, -0.019315, -0.0305004), (0.753383, 0.0775126, -0.0272313, 0.65243),
         (0.00478717, 0.00460903, 0.000709268)),
        (0.195862, (0.00429862, 0.000976676, -0.146197), (0.691246, 0.00357467, 0.00511118, 0.722592),
         (0.00149767, 0.00148468, 3.58427e-05)),
    ),
)  # fmt: skip


def _thigh(radius: float) -> tuple[Shape, ...]:
    return (
        _touch((0.8 * radius,), fromto=(0, 0, -0.05, 0, 0, -0.35)),
        _rod(radius, (0, 0.005, -0.06), (0, 0, -0.2)), _rod(0.8 * radius, (0, 0, -0.2), (0, 0, -0.36)),
        _rod(0.9 * radius, (0, -0.05, 0), (0, 0.05, 0), "dark", "cylinder"),
    )  # fmt: skip


def _shin(radius: float) -> tuple[Shape, ...]:
    return (
        _touch((0.7 * radius,), fromto=(0, 0, -0.03, 0, 0, -0.34)),
        _rod(radius, (0, -0.045, 0), (0, 0.045, 0), "dark", "cylinder"),
        _rod(radius, (0.005, 0, -0.06), (0.005, 0, -0.18)),
        _rod(0.65 * radius, (0.005, 0, -0.18), (0, 0, -0.37), "dark"),
    )  # fmt: skip


_H1_TORSO = (
    _touch((0.11,), fromto=(0, -0.03, 0.16, 0, -0.03, 0.4)), _touch((0.11,), fromto=(0, 0.03, 0.16, 0, 0.03, 0.4)),
    _touch((0.09,), "sphere", pos=(0.02, 0, 0.63)),
    _rod(0.05, (0, 0, 0), (0, 0, 0.12), "dark"), _look("box", (0.085, 0.1, 0.1), pos=(0, 0, 0.2)),
    _look("ellipsoid", (0.12, 0.155, 0.19), pos=(0, 0, 0.34)),
    _look("box", (0.02, 0.06, 0.035), "dark", pos=(0.11, 0, 0.34)),
    _rod(0.06, (0, -0.15, 0.43), (0, 0.15, 0.43), "dark", "cylinder"),
    _rod(0.035, (0, 0, 0.48), (0.01, 0, 0.58), "dark"),
    _look("ellipsoid", (0.085, 0.078, 0.115), pos=(0.015, 0, 0.64)),
    _look("ellipsoid", (0.06, 0.068, 0.098), "visor", pos=(0.045, 0, 0.645)),
    _look("cylinder", (0.045, 0.02), "glow", pos=(0.015, 0, 0.755)),
)  # fmt: skip
_H1_PELVIS = (
    _touch((0.075,), fromto=(0, -0.06, -0.08, 0, 0.06, -0.08)),
    _look("ellipsoid", (0.085, 0.12, 0.075), "dark", pos=(0, 0, -0.07)),
    _look("ellipsoid", (0.07, 0.1, 0.06), pos=(0, 0, -0.04)),
)  # fmt: skip
_H1_HIP = (_rod(0.058, (0, 0, -0.03), (0, 0, 0.07), "dark", "cylinder"),)
_H1_SHOULDER = (_look("sphere", (0.062,), "dark", pos=(0, 0.05, -0.015)),)
_H1_UPPER_ARM = (_touch((0.04,), fromto=(0, 0, -0.02, 0, 0, -0.12)), _rod(0.05, (0, 0, 0), (0, 0, -0.12)))

_H1_LINKS = (
    Link("pelvis", "", "", (0, 0, 0), 5.39, (-0.0002, 4e-05, -0.04522), (0.498303, 0.499454, -0.500496, 0.501741),
         (0.0490211, 0.0445821, 0.00824619), _H1_PELVIS),
    Link("left_hip_yaw_link", "pelvis", "left_hip_yaw", (0, 0.0875, -0.1742), 2.244, (-0.04923, 0.0001, 0.0072),
         (0.69699, 0.219193, 0.233287, 0.641667), (0.00304494, 0.00296885, 0.00189201), _H1_HIP),
    Link("left_hip_roll_link", "left_hip_yaw_link", "left_hip_roll", (0.039468, 0, 0), 2.232,
         (-0.0058, -0.00319, -9e-05), (0.0438242, 0.70721, -0.0729075, 0.701867), (0.00243264, 0.00225325, 0.00205492),
         (_rod(0.055, (-0.09, 0, 0), (0.03, 0, 0), "metal", "cylinder"),)),
    Link("left_hip_pitch_link", "left_hip_roll_link", "left_hip_pitch", (0, 0.11536, 0), 4.152,
         (0.00746, -0.02346, -0.08193), (0.979828, 0.0513522, -0.0169854, -0.192382),
         (0.0829503, 0.0821457, 0.00510909), _thigh(0.072)),
    Link("left_knee_link", "left_hip_pitch_link", "left_knee", (0, 0, -0.4), 1.721, (-0.00136, -0.00512, -0.1384),
         (0.626132, -0.034227, -0.0416277, 0.777852), (0.0125237, 0.0123104, 0.0019428), _shin(0.055)),
    Link("left_ankle_link", "left_knee_link", "left_ankle", (0, 0, -0.4), 0.446, (0.06722, 0.00015, -0.04497),
         (0.489101, 0.503197, 0.565782, 0.432972), (0.00220848, 0.00218961, 0.000214202), (
             *_sole((-0.1, 0.03, -0.065), (-0.1, -0.03, -0.065), (0.2, 0.03, -0.065), (0.2, -0.03, -0.065)),
             _rod(0.028, (0, 0, 0), (0.02, 0, -0.04), "dark"),
             _look("box", (0.15, 0.035, 0.012), "dark", pos=(0.05, 0, -0.056)),
             _look("ellipsoid", (0.13, 0.033, 0.025), pos=(0.05, 0, -0.045)),
         )),
    Link("torso_link", "pelvis", "torso", (0, 0, 0), 17.789, (0.000489, 0.002797, 0.20484),
         (0.999989, -0.00130808, -0.00282289, -0.00349105), (0.487315, 0.409628, 0.127837), _H1_TORSO),
    Link("left_shoulder_pitch_link", "torso_link", "left_shoulder_pitch", (0.0055, 0.15535, 0.42999), 1.033,
         (0.005045, 0.053657, -0.015715), (0.814858, 0.579236, -0.0201072, -0.00936488),
         (0.00129936, 0.000987113, 0.000858198), _H1_SHOULDER, turned=(0.976296, 0.216438, 0, 0)),
    Link("left_shoulder_roll_link", "left_shoulder_pitch_link", "left_shoulder_roll", (-0.0055, 0.0565, -0.0165), 0.793,
         (0.000679, 0.00115, -0.094076), (0.732491, 0.00917179, 0.0766656, 0.676384),
         (0.00170388, 0.00158256, 0.00100336), _H1_UPPER_ARM, turned=(0.976296, -0.216438, 0, 0)),
    Link("left_shoulder_yaw_link", "left_shoulder_roll_link", "left_shoulder_yaw", (0, 0, -0.1343), 0.839,
         (0.01365, 0.002767, -0.16266), (0.703042, -0.0331229, -0.0473362, 0.708798),
         (0.00408038, 0.00370367, 0.000622687), (
             _touch((0.035,), fromto=(0, 0, -0.03, 0.0185, 0, -0.18)), _rod(0.04, (0, 0, 0), (0.015, 0, -0.17), "dark"),
         )),
    Link("left_elbow_link", "left_shoulder_yaw_link", "left_elbow", (0.0185, 0, -0.198), 0.669,
         (0.15908, -0.000144, -0.015776), (0.0765232, 0.720327, 0.0853116, 0.684102),
         (0.00601829, 0.00600579, 0.000408305), (
             _touch((0.03,), fromto=(0.02, 0, -0.005, 0.27, 0, -0.016)),
             _rod(0.042, (0, -0.035, 0), (0, 0.035, 0), "metal", "cylinder"),
             _rod(0.036, (0.02, 0, -0.004), (0.22, 0, -0.014)),
             _look("ellipsoid", (0.05, 0.03, 0.038), "dark", pos=(0.28, 0, -0.016)),
         )),
)  # fmt: skip

_H1_2_LINKS = (
    Link("pelvis", "", "", (0, 0, 0), 5.983, (-0.0004, 3.7e-05, -0.046864), (0.497097, 0.496809, -0.503132, 0.502925),
         (0.0531565, 0.0491678, 0.00902583), _H1_PELVIS),
    Link("left_hip_yaw_link", "pelvis", "left_hip_yaw", (0, 0.0875, -0.1632), 2.829, (0, -0.026197, 0.006647),
         (0.704899, -0.0553755, 0.0548434, 0.705013), (0.00574303, 0.00455361, 0.00349461), _H1_HIP),
    Link("left_hip_pitch_link", "left_hip_yaw_link", "left_hip_pitch", (0, 0.0755, 0), 2.92,
         (-0.00781, -0.004724, -6.3e-05), (0.701575, 0.711394, 0.0330266, 0.0249149),
         (0.00560661, 0.00445055, 0.00385068), (_rod(0.06, (0, -0.05, 0), (0, 0.04, 0), "metal", "cylinder"),)),
    Link("left_hip_roll_link", "left_hip_pitch_link", "left_hip_roll", (0, 0, 0), 4.962,
         (0.004171, -0.008576, -0.194509), (0.634842, 0.0146079, 0.0074063, 0.772469),
         (0.0480229, 0.0462788, 0.00887409), _thigh(0.072)),
    Link("left_knee_link", "left_hip_roll_link", "left_knee", (0, 0, -0.4), 3.839, (0.000179, 0.000121, -0.168936),
         (0.416585, 0.0104983, 0.00514003, 0.909021), (0.0391044, 0.038959, 0.00501125), _shin(0.055)),
    Link("left_ankle_pitch_link", "left_knee_link", "left_ankle_pitch", (0, 0, -0.4), 0.102, (-0.000294, 0, -0.010794),
         (0.999984, 0, -0.00574445, 0), (2.39454e-05, 2.1837e-05, 1.34126e-05), (_look("sphere", (0.026,), "dark"),)),
    Link("left_ankle_roll_link", "left_ankle_pitch_link", "left_ankle_roll", (0, 0, -0.02), 0.747,
         (0.029589, 0, -0.015973), (0, 0.725858, 0, 0.687845), (0.00359178, 0.00343534, 0.000640307), (
             *_sole((-0.086, 0.042, -0.04), (-0.086, -0.042, -0.04), (0.174, 0.042, -0.04), (0.174, -0.042, -0.04)),
             _look("box", (0.13, 0.045, 0.012), "dark", pos=(0.044, 0, -0.032)),
             _look("ellipsoid", (0.115, 0.042, 0.026), pos=(0.04, 0, -0.022)),
         )),
    Link("torso_link", "pelvis", "torso", (0, 0, 0), 17.789, (0.000489, 0.002797, 0.20484),
         (0.999989, -0.00130808, -0.00282289, -0.00349105), (0.487315, 0.409628, 0.127837), _H1_TORSO),
    Link("left_shoulder_pitch_link", "torso_link", "left_shoulder_pitch", (0, 0.14806, 0.42333), 1.327,
         (0.003053, 0.06042, -0.0059), (0.761799, 0.645681, -0.0378496, -0.0363943),
         (0.000588757, 0.00053309, 0.000393023), _H1_SHOULDER, turned=(0.991445, 0.130526, 0, 0)),
    Link("left_shoulder_roll_link", "left_shoulder_pitch_link", "left_shoulder_roll", (0.0342, 0.061999, -0.0060011),
         1.393, (-0.030932, -1e-06, -0.10609), (0.986055, 0.000456937, 0.166408, 0.00213553),
         (0.00200869, 0.00193464, 0.000449847), tuple(
             shape | {"fromto": _text((-0.034, 0, 0, -0.034, 0, -0.13))} for shape in _H1_UPPER_ARM
         ), turned=(0.991445, -0.130526, 0, 0)),
    Link("left_shoulder_yaw_link", "left_shoulder_roll_link", "left_shoulder_yaw", (-0.0342, 0, -0.1456), 1.505,
         (0.004583, 0.001128, -0.001128), (0.663644, -0.0108866, -0.0267235, 0.747492),
         (0.00431782, 0.00420697, 0.000645658), (
             _touch((0.035,), fromto=(0, 0, -0.03, 0.006, 0.01, -0.16)),
             _rod(0.042, (0, 0, 0), (0.006, 0.01, -0.15), "dark"),
         )),
    Link("left_elbow_pitch_link", "left_shoulder_yaw_link", "left_elbow_pitch", (0.006, 0.0329, -0.182), 0.691,
         (0.077092, -0.028751, -0.009714), (0.544921, 0.610781, 0.423352, 0.388305),
         (0.000942091, 0.000905273, 0.00023025), (
             _touch((0.03,), fromto=(0.02, -0.033, -0.005, 0.1, -0.033, -0.01)),
             _rod(0.04, (0, -0.065, 0), (0, 0.005, 0), "metal", "cylinder"),
             _rod(0.037, (0.02, -0.033, -0.004), (0.1, -0.033, -0.01)),
         )),
    Link("left_elbow_roll_link", "left_elbow_pitch_link", "left_elbow_roll", (0.121, -0.0329, -0.011), 0.683,
         (0.035281, -0.00232, 0.000337), (0.334998, 0.622198, -0.240131, 0.66557),
         (0.00034681, 0.000328248, 0.000294628), (_rod(0.035, (0, 0, 0), (0.07, 0, 0)),), is_mirrored=False),
    Link("left_wrist_pitch_link", "left_elbow_roll_link", "left_wrist_pitch", (0.085, 0, 0), 0.484,
         (0.020395, 3.6e-05, -0.002973), (0.915893, -0.228405, -0.327262, -0.0432527),
         (7.25675e-05, 7.00325e-05, 6.9381e-05), (_look("sphere", (0.033,), "dark"),), is_mirrored=False),
    Link("left_wrist_yaw_link", "left_wrist_pitch_link", "left_wrist_yaw", (0.02, 0, 0), 0.26543,
         (0.0770303, -0.00131441, -0.00068617), (0.499919, 0.510625, 0.506813, 0.482165),
         (0.000854397, 0.000723298, 0.00022115), (
             _touch((0.03,), fromto=(0.05, 0, 0, 0.16, 0, 0)), _rod(0.026, (0.01, 0, 0), (0.05, 0, 0), "metal"),
             _look("box", (0.045, 0.014, 0.04), "dark", pos=(0.105, 0, 0)),
             _rod(0.01, (0.12, -0.02, 0.02), (0.16, -0.05, 0.03), "dark"),
             _rod(0.011, (0.15, 0, 0.028), (0.21, 0, 0.03), "dark"), _rod(0.011, (0.15, 0, 0), (0.22, 0, 0), "dark"),
             _rod(0.011, (0.15, 0, -0.026), (0.21, 0, -0.028), "dark"),
         )),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Extra:
    """What a model has beside its links.

    Attributes:
        friction_nm: Dry friction of a joint, by the end of its name; "" for all [N m].
        imu, head: Body and place of the IMU and of the camera that looks ahead [m].
    """

    friction_nm: Mapping[str, float]
    imu: tuple[str, Vector]
    head: tuple[str, Vector]


_H1_EXTRA = _Extra({"": 0.1}, ("torso_link", (-0.04452, -0.01891, 0.27756)), ("torso_link", (0.11, 0, 0.65)))
_LINKS: dict[str, tuple[tuple[Link, ...], _Extra]] = {
    GO2.name: (
        (_GO2_TRUNK, *_corners(_GO2_LEG, ("FL", "FR", "RL", "RR"))),
        _Extra({"": 0.0}, ("base", (-0.02557, 0, 0.04232)), ("base", (0.345, 0, 0.02))),
    ),
    GO1.name: (
        (_GO1_TRUNK, *_corners(_GO1_LEG, ("FR", "FL", "RR", "RL"))),
        _Extra({"_calf": 1.0, "": 0.3}, ("trunk", (-0.01592, -0.06659, -0.00617)), ("trunk", (0.305, 0, 0.01))),
    ),
    **dict.fromkeys((H1.name, H1_10.name), (tuple(_both_sides(_H1_LINKS)), _H1_EXTRA)),
    **dict.fromkeys((H1_2.name, H1_2_12.name), (tuple(_both_sides(_H1_2_LINKS)), _H1_EXTRA)),
}


def build(name: str, source: str) -> str:
    """Return the text of a model.

    Args:
        name: Of its robot, the suffix of its keys.
        source: The text of ``g1.xml``.
    """
    root = fromstring(source, parser=XMLParser(target=TreeBuilder(insert_comments=True)))
    robot = ROBOTS[name]
    root.set("model", name)
    root[0].text = (
        f" {robot.title}, without meshes. Made by adapters/robots/legged/models.py, which says where its numbers come "
        "from: change that, not this file. "
    )
    if name in _LINKS:
        _replace_body(root, robot, *_LINKS[name])
    else:
        _OF_G1[name](root)
    _replace_motors(root, robot)
    indent(root, "  ")
    return re.sub(r"[ \t]+\n", "\n", tostring(root, encoding="unicode")) + "\n"


def stand(robot: LeggedRobot) -> str:
    """Return the text of the file by which the policy `direct` has a robot stand."""
    joints = zip(robot.joint_names, robot.stand_kp, robot.stand_kd, robot.start_q, strict=True)
    lines = [f"  - {{name: {name}, kp: {kp:g}, kd: {kd:g}, default_rad: {q:g}}}" for name, kp, kd, q in joints]
    return (
        f"# How a {robot.title} stands without a network. Made by models.py from the table in unitree.py.\n"
        f"command: {robot.name.replace('_', '-')}-joints\nrate_hz: 50\n"
        "lead_rad: 6.3  # it falls rather than yields\njoints:\n" + "\n".join(lines) + "\n"
    )


def files() -> Iterator[tuple[Path, str]]:
    """Yield each file that is made, with its text."""
    source = SOURCE.read_text(encoding="utf-8")
    for name, robot in ROBOTS.items():
        yield HERE / f"{name}.xml", build(name, source)
        yield HERE / f"{name}.stand.yaml", stand(robot)


def main() -> None:
    """Write the files."""
    for path, text in files():
        path.write_text(text, encoding="utf-8")


def _replace_body(root: Element, robot: LeggedRobot, links: tuple[Link, ...], extra: _Extra) -> None:
    defaults = _only(root, "default")
    for child in defaults.findall("default"):
        if child.get("class") not in ("look", "limb"):
            defaults.remove(child)
    for comment in [child for child in defaults if not isinstance(child.tag, str)]:
        defaults.remove(comment)
    limb = _only(defaults, "default[@class='limb']")
    for arm_or_trunk in [child for child in limb.findall("default") if child.get("class") != "sole"]:
        limb.remove(arm_or_trunk)  # its limbs touch the ground, and not each other
    _only(root, "statistic").set("center", f"0 0 {_text([0.7 * robot.start_height_m])}")
    world = _only(root, "worldbody")
    old = _only(world, "body")
    kept = {child.tag: deepcopy(child) for child in old if child.tag in ("light", "camera")}
    farther = max(0.6, robot.start_height_m / G1_12.start_height_m)  # the camera that follows shows it as large as a G1
    kept["camera"].set("pos", _text(farther * float(word) for word in kept["camera"].get("pos", "").split()))
    world.remove(old)
    bodies = {"": world}
    rows = {joint.name: joint for joint in robot.joints}
    for link in links:
        frame = {"name": link.name, "pos": _text(link.position)}
        if link.turned != (1, 0, 0, 0):
            frame["quat"] = _text(link.turned)
        body = bodies[link.name] = SubElement(
            bodies[link.parent or (robot.root if bodies.keys() > {""} else "")], "body", frame
        )
        SubElement(body, "inertial", pos=_text(link.com), quat=_text(link.axes), mass=_text([link.mass_kg]),
                   diaginertia=_text(link.inertia))  # fmt: skip
        if link.name == robot.root:
            body.set("pos", _text((0, 0, robot.start_height_m)))
            body.set("childclass", "look")
            SubElement(body, "freejoint", name="root")
            body.extend(kept.values())
        row = rows.get(link.joint)
        if row is not None:
            friction_nm = next(value for end, value in extra.friction_nm.items() if row.name.endswith(end))
            SubElement(body, "joint", name=row.mjcf_name, axis=_UNIT[row.axis], range=_text((row.lower, row.upper)),
                       armature=_text([row.armature]), frictionloss=_text([friction_nm]),
                       actuatorfrcrange=_text((-row.effort_nm, row.effort_nm)))  # fmt: skip
        body.extend(Element("geom", shape) for shape in link.shapes)
    where, at = extra.imu
    SubElement(bodies[where], "site", name="imu", pos=_text(at))
    where, at = extra.head
    SubElement(bodies[where], "camera", name="head", pos=_text(at), xyaxes=_AHEAD, fovy="65")


def _replace_motors(root: Element, robot: LeggedRobot) -> None:
    motors = _only(root, "actuator")
    motors.clear()
    for joint, kp, kd in zip(robot.joints, robot.stand_kp, robot.stand_kd, strict=True):
        SubElement(motors, "position", name=joint.mjcf_name, joint=joint.mjcf_name, kp=_text([kp]), kv=_text([kd]),
                   forcerange=_text((-joint.effort_nm, joint.effort_nm)))  # fmt: skip
    stands = _text(robot.start_q)
    key = _only(root, "keyframe/key")
    key.set("qpos", f"0 0 {_text([robot.start_height_m])} 1 0 0 0 {stands}")
    key.set("ctrl", stands)


def _with_12_joints(root: Element) -> None:
    """Fix waist and arms, and put their mass into the pelvis, as Unitree's model of 12 joints does."""
    pelvis = _only(root, ".//body[@name='pelvis']")
    for body in _only(pelvis, "body[@name='waist_yaw_link']").iter("body"):
        _fix(body, is_weightless=True)
    _weigh(pelvis, 17.7349, (0.0144905, 0.000151462, 0.144068), (0.999881, -0.000505543, -0.0154276, 0.000328408),
           (0.552723, 0.454092, 0.211762))  # fmt: skip


def _with_23_joints(root: Element) -> None:
    """Fix two joints of the waist and two of each wrist; hand and wrist are one link, and the waist weighs nothing."""
    for name in ("waist_roll_link", "torso_link"):
        _fix(_only(root, f".//body[@name='{name}']"), is_weightless=name != "torso_link")
    waist = _only(root, ".//body[@name='waist_yaw_link']")
    _weigh(waist, None)
    waist.set("pos", "-0.0039635 0 0")  # its axis goes through the torso's origin
    _only(waist, "body").set("pos", "0 0 0.044")
    for side, sign in (("left", 1), ("right", -1)):
        for name in ("wrist_pitch_link", "wrist_yaw_link"):
            _fix(_only(root, f".//body[@name='{side}_{name}']"), is_weightless=True)
        hand = _only(root, f".//body[@name='{side}_wrist_roll_link']")
        axes = (0.494051, sign * 0.504265, 0.48416, sign * 0.516933)
        _weigh(hand, 0.356929, (0.107947, sign * 0.00163512, 0.00202245), axes, (0.00200292, 0.0019426, 0.000195232))


_OF_G1 = {G1_12.name: _with_12_joints, G1_23.name: _with_23_joints, G1_DEX3.name: give_hands}


def _fix(body: Element, *, is_weightless: bool) -> None:
    body.remove(_only(body, "joint"))
    if is_weightless:
        _weigh(body, None)


def _weigh(body: Element, mass_kg: float | None, com: Vector = (), axes: Vector = (), inertia: Vector = ()) -> None:
    """Set what a body weighs, or that it weighs nothing."""
    inertial = _only(body, "inertial")
    if mass_kg is None:
        body.remove(inertial)
        return
    for name, value in (("pos", com), ("quat", axes), ("mass", (mass_kg,)), ("diaginertia", inertia)):
        inertial.set(name, _text(value))


def _only(root: Element, path: str) -> Element:
    (found,) = root.findall(path)
    return found


if __name__ == "__main__":
    main()
