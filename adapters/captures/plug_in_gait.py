"""From the markers of Plug-in Gait's full-body set to joints and parts of a person.

| part | markers |
|---|---|
| pelvis | ``LASI RASI`` and ``LPSI RPSI``, or ``SACR`` for both of these |
| leg | ``LKNE`` (outer side of the knee), ``LANK`` (outer ankle), ``LHEE``, ``LTOE``; right ones with ``R`` |
| trunk | ``C7``, ``CLAV``, ``STRN``, ``T10`` |
| arm | ``LSHO`` (top of the shoulder), ``LELB`` (outer elbow), ``LWRA`` (thumb's side of a wrist), ``LWRB``, ``LFIN`` |
| head | ``LFHD RFHD LBHD RBHD``, those that there are |

``T10`` or ``STRN`` may be absent, one of them; so may fingers and head. A joint lies inwards of its marker, by a share
of the height, where measurements of the subject (widths of knees and ankles) would be better. Hips follow Harrington
and others, *Prediction of the hip joint centre*, Journal of Biomechanics 40 (2007), by width and depth of the pelvis.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from adapters.captures import geometry
from adapters.retarget.bone_frames import along_z, directed
from adapters.retarget.human import SIDES, of_height
from adapters.robots.g1.kinematics import about
from station.errors import BadFile
from station.protocols import Floats

_SIDED = ("ASI", "KNE", "ANK", "HEE", "TOE", "SHO", "ELB", "WRA", "WRB")
NEEDED = (*(f"{side}{name}" for name in _SIDED for side in "LR"), "C7", "CLAV")
"""Without any of these there is no person; beside them `expect` asks for backs of pelvis and chest."""

_HEAD = ("LFHD", "RFHD", "LBHD", "RBHD")
LABELS = frozenset((*NEEDED, "LPSI", "RPSI", "SACR", "T10", "STRN", "LFIN", "RFIN", *_HEAD))
"""All that are read."""

_KNEE, _ANKLE, _ELBOW, _SHOULDER = 0.031, 0.024, 0.025, 0.028
"""How far inwards of their markers joints are, shares of the height."""

_TILT = np.radians(12.0)
"""A pelvis that stands has its back that much higher than its front."""


def expect(path: Path, markers: Collection[str]) -> None:
    """Check that there are markers enough.

    Raises:
        BadFile: one is missing that is needed.
    """
    missing = [label for label in NEEDED if label not in markers]
    if not {"LPSI", "RPSI"} <= set(markers) and "SACR" not in markers:
        missing.append("LPSI and RPSI, or SACR")
    if not {"T10", "STRN"} & set(markers):
        missing.append("T10 or STRN")
    if missing:
        found = ", ".join(sorted(markers)) or "none of the set"
        raise BadFile(
            f"{path}: marker {missing[0]} is not in it, or hidden for too long; expected the labels of Plug-in Gait; "
            f"came {found[:200]}"
        )


def joints(markers: Mapping[str, Floats]) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return places (n, 3) and orientations (n, 3, 3) of a person, as `adapters.captures.joints.Joints` has them.

    Args:
        markers: By label, shape (n, 3), none of them hidden, in any unit.
    """
    front = 0.5 * (markers["LASI"] + markers["RASI"])
    back = 0.5 * (markers["LPSI"] + markers["RPSI"]) if "LPSI" in markers and "RPSI" in markers else markers["SACR"]
    across = markers["LASI"] - markers["RASI"]
    tilted = geometry.upright(np.cross(front - back, across), across)
    ankle_marker = 0.5 * (markers["LANK"] + markers["RANK"])
    tall = _height(markers)
    places = _hips(markers, front, back, tilted, tall)
    turns = {"pelvis": tilted @ about("y", np.array(-_TILT)), "chest": _chest(markers)}
    places["neck"], places["head"] = _neck_and_head(markers, turns["chest"], tall)
    up = geometry.axis_up(places["head"], ankle_marker)
    for side, letter, sign in zip(SIDES, "LR", (1.0, -1.0), strict=True):
        of_side = {label[1:]: points for label, points in markers.items() if label.startswith(letter)}
        foot = _foot(of_side, up)
        ankle = of_side["ANK"] - sign * foot[..., 1] * _ANKLE * tall
        knee = _inwards(places[f"{side}_hip"], of_side["KNE"], ankle, _KNEE * tall, -sign)
        places |= {f"{side}_knee": knee, f"{side}_ankle": ankle, f"{side}_ball": of_side["TOE"]}
        turns[f"{side}_foot"] = foot
        _put_arm(places, turns, of_side, side, tall)
    return places, turns


def _height(markers: Mapping[str, Floats]) -> float:
    """Return how tall the person is, in the markers' unit, by the shanks: their markers keep their distance."""
    shanks = [float(np.median(np.linalg.norm(markers[f"{s}KNE"] - markers[f"{s}ANK"], axis=1))) for s in "LR"]
    return sum(shanks) / 2.0 / of_height(1.0).shank


def _hips(markers: Mapping[str, Floats], front: Floats, back: Floats, frame: Floats, tall: float) -> dict[str, Floats]:
    width = float(np.median(np.linalg.norm(markers["LASI"] - markers["RASI"], axis=1)))
    depth = float(np.median(np.linalg.norm(front - back, axis=1)))
    mm = tall / 1700.0  # the regression has parts in millimetres; the unit is not known here, an adult of 1.7 m is
    down, aside, behind = 0.30 * width + 10.9 * mm, 0.33 * width + 7.3 * mm, 0.24 * depth + 9.9 * mm
    return {
        f"{side}_hip": front + frame @ np.array([-behind, sign * aside, -down])
        for side, sign in zip(SIDES, (1.0, -1.0), strict=True)
    }


def _chest(markers: Mapping[str, Floats]) -> Floats:
    """Up is from the lower pair of markers to the upper one; where one is missing, along the spine or sternum."""
    shoulders = markers["LSHO"] - markers["RSHO"]
    if "T10" not in markers:
        up = markers["CLAV"] - markers["STRN"]
    elif "STRN" not in markers:
        up = markers["C7"] - markers["T10"]
    else:
        up = markers["C7"] + markers["CLAV"] - markers["T10"] - markers["STRN"]
    return geometry.upright(up, shoulders)


def _neck_and_head(markers: Mapping[str, Floats], chest: Floats, tall: float) -> tuple[Floats, Floats]:
    neck = 0.5 * (markers["C7"] + markers["CLAV"])
    seen = [markers[label] for label in _HEAD if label in markers]
    if len(seen) == len(_HEAD):
        return neck, sum(seen) / len(seen) - 0.026 * tall * chest[..., 2]
    return neck, neck + chest[..., 2] * of_height(1.0).head * tall


def _foot(of_side: Mapping[str, Floats], up: Floats) -> Floats:
    """Return frames of a foot: three of its markers, which are rigid, fitted to it being level where it is lowest."""
    heel, toe = of_side["HEE"], of_side["TOE"]
    rigid = along_z(np.cross(toe - heel, of_side["ANK"] - heel), toe - heel)
    flat = geometry.lowest((heel + toe) @ up)
    return rigid @ geometry.fitted(rigid[flat], geometry.level_foot(heel, toe, up)[flat])


def _put_arm(
    places: dict[str, Floats], turns: dict[str, Floats], of_side: Mapping[str, Floats], side: str, tall: float
) -> None:
    sign, chest = 1.0 if side == "left" else -1.0, turns["chest"]
    shoulder = of_side["SHO"] - chest[..., 2] * _SHOULDER * tall
    wrist = 0.5 * (of_side["WRA"] + of_side["WRB"])
    elbow = _inwards(shoulder, of_side["ELB"], wrist, _ELBOW * tall, sign)
    places |= {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow, f"{side}_wrist": wrist}
    towards = of_side["FIN"] - wrist if "FIN" in of_side else wrist - elbow
    thumb = of_side["WRA"] - of_side["WRB"]
    turns[f"{side}_hand"] = geometry.arm(sign, towards, sign * np.cross(thumb, directed(towards)))


def _inwards(upper: Floats, marker: Floats, lower: Floats, depth: float, sign: float) -> Floats:
    """Return where a hinge is, shape (n, 3): `depth` inwards of its marker, along the axis about which it bends.

    The marker is beside the line from the upper end of the limb to the lower one, by the bend and, at a right angle to
    that, by the depth; how far it is tells how much of each. Of a straight limb it is the depth alone. `sign` is 1 for
    a left limb that bends forward as an elbow does, -1 for a right one; for knees it is the other way round.
    """
    along = directed(lower - upper)
    beside = marker - upper
    beside = beside - along * (beside * along).sum(axis=-1, keepdims=True)
    away = np.linalg.norm(beside, axis=-1, keepdims=True)
    cosine = np.clip(depth / np.maximum(away, 1e-9), 0.0, 1.0)
    beside = directed(beside)
    outward = cosine * beside + sign * np.sqrt(1.0 - cosine**2) * np.cross(along, beside)
    return np.asarray(marker - outward * depth)
