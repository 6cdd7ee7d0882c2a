"""``station check`` tells what was broken on purpose; which kinds it does not tell is listed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.corruption.bench import Bench, make_episodes
from tests.corruption.recipes import RECIPES
from tests.figures import Figures

CAUGHT = 85
"""Kinds that are told at least, of the 141 in `RECIPES`; 89 were when this was written. Raise it with new checks."""

pytestmark = [pytest.mark.timeout(3600), pytest.mark.usefixtures("processes")]


def test_corruptions_are_told(proof: Figures, tmp_path: Path) -> None:
    bench = Bench(tmp_path, make_episodes(tmp_path), is_audited=False)
    bench.run(list(RECIPES), jobs=2)
    counts = bench.counts()
    proof.figure(
        "kinds of corruption that a check tells", f"{counts['caught']} of {counts['kinds']}", limit=f"{CAUGHT}"
    )
    proof.figure("of them, with a reason that names what and when", counts["caught, names what and when"])
    assert counts["crashed"] == 0
    assert counts["caught"] >= CAUGHT, "missed:\n" + "\n".join(
        f"{name} ({each})" for name, each in bench.missed().items()
    )
