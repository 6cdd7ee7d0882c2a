"""How many random examples a test tries: a third in `make test`, where they are the same ones every time; all of them
where new ones are drawn (``--new-examples``: `make hunt` and the proofs)."""

from __future__ import annotations

_LEAST = 10
_draws = {"new": False}


def draw_new(is_new: bool) -> None:
    """Decide for this run; before test modules are imported."""
    _draws["new"] = is_new


def examples(count: int) -> int:
    """Return how many of `count` examples are tried in this run."""
    return count if _draws["new"] else max(_LEAST, count // 3)
