"""Sweeps and random examples of which `make test` tries a third: here whole, and with examples of this day."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.figures import Figures
from tests.tiers import ROOT

pytestmark = [pytest.mark.timeout(3600), pytest.mark.usefixtures("processes")]


def test_the_unit_tier_holds_for_whole_sweeps_and_new_examples(proof: Figures, tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    command = [sys.executable, "-m", "pytest", "-m", "unit", "--new-examples", "-n", str(os.cpu_count()), "--dist",
               "loadscope", "-p", "no:cacheprovider", f"--junitxml={report}"]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, done.stdout[-20_000:]
    tests = len(list(ElementTree.parse(report).getroot().iter("testcase")))
    proof.figure("tests of the unit tier with whole sweeps and new examples", f"{tests}: 0 failed", limit="0 failed")
