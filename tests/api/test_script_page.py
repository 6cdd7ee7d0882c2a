"""The examples of `docs/script.md`, as they stand there and in their order, on a station that runs."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.cli.running import Home
from tests.tiers import ROOT

PAGE = (ROOT / "docs" / "script.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


@pytest.mark.usefixtures("patient_stop")
def test_the_examples_run(own: Home, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    for example in EXAMPLES:
        exec(example, names)
        if names["lab"] is not None and "done" in names and "said" not in names:
            names["said"] = capsys.readouterr().out.split()
    assert names["said"] in (["good"], ["usable"], ["reject"]), "a busy machine may be late"
    assert names["stopped"] == ["g1"]
    assert names["steps"][-1][0].startswith("start motion ")
    assert {state for _, state in names["steps"]} == {"done"}
    assert names["gate"]["arming"] == "armed"
    assert (len(names["joints"]), len(names["vector"])) == (29, 65)
    assert names["begun"].detail["episode_id"]
    assert (len(names["angles"]), names["gate_now"].json()["arming"]) == (3, "armed")


def test_robot_armed_recorded_marked_stopped_and_judged_in_ten_lines() -> None:
    lines = [line for line in EXAMPLES[0].splitlines() if line.strip()]
    assert len(lines) <= 10
    for word in ("wait_for_robot", ".arm(", "record.start(", "record.mark(", "record.stop(", ".verdict"):
        assert word in EXAMPLES[0]
