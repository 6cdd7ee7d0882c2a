"""Frames as the headset's app sends them, written by hand: right-handed, x right, y up, z back, quaternions x y z w."""

from __future__ import annotations

from typing import Any

IDENTITY = "0,0,0,1"


def controller(pose: str, **fields: Any) -> dict[str, Any]:
    at_rest = {
        "trigger": 0.0, "grip": 0.0, "axisX": 0.0, "axisY": 0.0, "axisClick": False, "primaryButton": False,
        "secondaryButton": False, "menuButton": False,
    }  # fmt: skip
    return {"pose": pose, **at_rest, **fields}


def head(pose: str) -> dict[str, Any]:
    return {"pose": pose, "status": 3, "handMode": 0}


def body(stamp_ns: int, poses: list[str]) -> dict[str, Any]:
    joints = [{"p": pose, "t": stamp_ns, "va": "9,9,9,9,9,9", "wva": "9,9,9,9,9,9"} for pose in poses]
    return {"dt": 0, "flags": 0, "timeStampNs": stamp_ns, "joints": joints}


def hand(pose: str, is_active: int = 1) -> dict[str, Any]:
    places = [{"p": pose, "s": 15, "r": 0.01}] * 26
    return {"isActive": is_active, "count": 26, "scale": 1, "HandJointLocations": places}


def frame(stamp_ns: int, **kinds: Any) -> dict[str, Any]:
    """A frame with a head and two controllers that tremble, as held ones do."""
    pair = {side: controller(f"{stamp_ns % 97}e-6,0,0,{IDENTITY}") for side in ("left", "right")}
    usual = {"Head": head(f"0,0,0,{IDENTITY}"), "Controller": pair}
    found = {**usual, **kinds, "timeStampNs": stamp_ns, "predictTime": 0, "appState": {"focus": True}, "Input": 1}
    return {name: kind for name, kind in found.items() if kind is not None}
