"""Of hundreds of wrong inputs on a narrow Latin-1 terminal without a display none hangs or shows a traceback."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.running import Home
from tests.cli.wrong_inputs import BARE, cases, complaint, furnish
from tests.figures import Figures

pytestmark = pytest.mark.timeout(900)  # each starts a cold interpreter

EACH = 10


def test_wrong_inputs_end_in_a_line_and_an_exit_code(home: Home, tmp_path: Path, proof: Figures) -> None:
    furnish(tmp_path)
    os.chmod(tmp_path, 0o555)
    tried = list(cases())[::EACH]
    wrong = [complaint(case, tmp_path, {**home.environment, **BARE}, encoding="latin-1") for case in tried]
    assert not [found for found in wrong if found]
    proof.figure("wrong inputs that hang, show a traceback or end in a wrong exit code", 0, limit=f"0 of {len(tried)}")
