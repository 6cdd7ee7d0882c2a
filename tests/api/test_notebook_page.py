"""The examples of `docs/notebook.md`, as they stand there, on a recorded walk."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tests.api.libraries import needs
from tests.export.pictured import walked
from tests.tiers import ROOT

PAGE = (ROOT / "docs" / "notebook.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
OPENED, NUMBERS = EXAMPLES[:2]


@pytest.fixture
def notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Names of a notebook after the first cell of the page."""
    walked(tmp_path, seconds=0.5, has_depth=True)
    monkeypatch.setenv("STATION_DATA", str(tmp_path))
    names: dict[str, Any] = {}
    exec(OPENED, names)
    names["robot"] = names["episode"].robots[0]
    return names


@pytest.mark.parametrize("example", EXAMPLES[1:], ids=lambda example: example.partition("\n")[0].partition("  ")[0])
def test_an_example_runs(notebook: dict[str, Any], example: str) -> None:
    needs(*(library for library in ("pandas", "polars") if f".{library}(" in example))
    exec(example, notebook)


def test_joint_positions_of_the_newest_episode_are_a_frame_in_five_lines(notebook: dict[str, Any]) -> None:
    lines = [line for line in (OPENED + NUMBERS).splitlines() if line.strip() and "print" not in line]
    assert len(lines) <= 5
    needs("pandas")
    exec(NUMBERS, notebook)
    frame = notebook["frame"]
    assert frame.shape == (25, 29)
    assert frame.index.name == "time_s"
    assert frame.index[:2].tolist() == pytest.approx([0.1002, 0.1202])
    assert frame["left_hip_pitch_pos"].tolist() == pytest.approx([number / 1000 for number in range(25)])
    assert set(frame.attrs["units"]) == set(frame.columns)
    assert frame.attrs["units"]["left_knee_pos"] == "rad"
