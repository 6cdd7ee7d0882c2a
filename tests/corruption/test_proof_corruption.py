"""``station check`` tells what was broken on purpose; which kinds it does not tell is listed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.corruption.bench import Bench, make_episodes
from tests.corruption.recipes import RECIPES
from tests.figures import Figures

CAUGHT = 125
"""Kinds that are told at least, of the 141 in `RECIPES`; 129 were when this was written. Raise it with new checks."""
NAMED = 120
"""Of them, those whose reason names what was harmed and when; 129 were."""

pytestmark = [pytest.mark.timeout(3600), pytest.mark.usefixtures("processes")]


def test_corruptions_are_told(proof: Figures, tmp_path: Path) -> None:
    bench = Bench(tmp_path, make_episodes(tmp_path), is_audited=False)
    bench.run(list(RECIPES), jobs=2)
    counts = bench.counts()
    proof.figure(
        "kinds of corruption that a check tells", f"{counts['caught']} of {counts['kinds']}", limit=f"{CAUGHT}"
    )
    named = counts["caught, names what and when"]
    proof.figure("of them, with a reason that names what and when", named, limit=f"{NAMED}")
    assert counts["crashed"] == 0
    assert named >= NAMED
    assert counts["caught"] >= CAUGHT, "missed:\n" + "\n".join(
        f"{name} ({each})" for name, each in bench.missed().items()
    )
