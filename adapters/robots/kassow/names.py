"""What a Kassow arm and its joints are called: its maker's folder of limits, and the suffix of its keys."""

from __future__ import annotations

MAKER = "kassow"

ARM_7 = tuple(f"joint_{number}" for number in range(1, 8))
"""Joints of an arm, from its base to its flange."""


def suffix(model: str, name: str = "") -> str:
    """Return the suffix of an arm's keys; `name` tells two of one model apart."""
    return "_".join(filter(None, (MAKER, model, name)))


def without_name(robot: str) -> str:
    """Return the suffix of the only arm of a model for that of any of them."""
    return "_".join(robot.split("_")[:2])


KR810_ROBOT = suffix("kr810")
"""Suffix of the keys of the arm that ships."""
