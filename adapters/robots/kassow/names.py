"""What a Kassow arm is called: its maker's folder of limits, and the suffix of its keys."""

from __future__ import annotations

MAKER = "kassow"


def suffix(model: str, name: str = "") -> str:
    """Return the suffix of an arm's keys; `name` tells two of one model apart."""
    return "_".join(filter(None, (MAKER, model, name)))
