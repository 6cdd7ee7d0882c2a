"""Episodes of version 0.1 stay readable: checked, audited, replayed and exported to the figures that it found itself.

`episodes/` and `figures.json` were made by version 0.1, whose station walked, jogged and looked. Neither is ever made
anew: a figure that changes is a change of what old data says.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.episode.of_version_0_1.figures import figures

PLACE = Path(__file__).parent
EXPECTED: dict[str, dict[str, Any]] = json.loads((PLACE / "figures.json").read_text(encoding="utf-8"))
BY_VERSIONS = {"max_abs_difference", "different", "first_different", "max_q_difference_rad", "max_root_difference_m"}
"""Bits of an inference or of physics: the same with the same versions of their libraries, close with others."""
CLOSE = 1e-3
SAID_OTHERWISE = {"command format twist2": "description of unitree_g1"}
"""What names a source that was moved since: the same limits of joints."""


def differences(expected: Any, found: Any, path: str = "") -> Iterator[str]:
    """Yield what is not as it was; what a later version tells beside is no difference."""
    if isinstance(expected, dict):
        for name, value in expected.items():
            if not isinstance(found, dict) or name not in found:
                yield f"{path}.{name} is gone"
            elif not (name in BY_VERSIONS and path.startswith((".audit", ".replay"))):
                yield from differences(value, found[name], f"{path}.{name}")
    elif isinstance(expected, list):
        if not isinstance(found, list) or len(found) != len(expected):
            yield f"{path} was {expected}, is {found}"
            return
        for place, (value, other) in enumerate(zip(expected, found, strict=True)):
            yield from differences(value, other, f"{path}[{place}]")
    elif isinstance(expected, float):
        if not isinstance(found, (int, float)) or found != pytest.approx(expected, rel=1e-9, abs=1e-9):
            yield f"{path} was {expected}, is {found}"
    elif SAID_OTHERWISE.get(expected, expected) != found:
        yield f"{path} was {expected!r}, is {found!r}"


@pytest.mark.parametrize("name", EXPECTED)
def test_an_old_episode_has_the_figures_that_it_had(tmp_path: Path, name: str) -> None:
    episode = shutil.copytree(PLACE / "episodes" / name, tmp_path / name)
    found = json.loads(json.dumps(figures(episode, tmp_path / "out")))
    assert list(differences(EXPECTED[name], found)) == []
    if "targets" in found["audit"]:  # an arm's audit is arithmetic, the same with all versions of everything
        for side in ("commands", "targets"):
            assert found["audit"][side]["compared"] > 50
            assert found["audit"][side]["different"] == 0
    else:
        assert found["audit"]["steps"] > 0
        assert found["audit"]["max_abs_difference"] < CLOSE
        assert found["replay"]["max_q_difference_rad"] < CLOSE
