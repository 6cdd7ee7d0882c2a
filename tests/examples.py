"""How much of a sweep or of random examples a test tries: in `make test` a fifth, the same one every time; with
``--new-examples`` all of it, and examples of this day (`make hunt`, and `tests/test_proof_examples.py`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

_Case = TypeVar("_Case")
_LEAST = 10
_draws = {"new": False}


def draw_new(is_new: bool) -> None:
    """Decide for this run; before test modules are imported."""
    _draws["new"] = is_new


def examples(count: int) -> int:
    """Return how many of `count` random examples are tried in this run."""
    return count if _draws["new"] else max(_LEAST, count // 5)


def some(cases: Iterable[_Case]) -> list[_Case]:
    """Return which cases of a sweep are tried in this run: every fifth, from the first."""
    return list(cases) if _draws["new"] else list(cases)[::5]
