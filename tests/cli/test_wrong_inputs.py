"""A sample of all wrong inputs (`tests/cli/test_proof_wrong_inputs.py` has many more) is refused in a line."""

from __future__ import annotations

from pathlib import Path

from tests.cli.running import Home
from tests.cli.wrong_inputs import cases, complaint, furnish
from tests.examples import some

EACH = 20


def test_wrong_inputs_end_in_a_line_and_an_exit_code(home: Home, tmp_path: Path) -> None:
    furnish(tmp_path)
    wrong = [complaint(case, tmp_path, home.environment) for case in some(list(cases())[::EACH])]
    assert not [found for found in wrong if found]


def test_names_that_no_file_can_have_are_refused(home: Home, tmp_path: Path) -> None:
    """Each verb has its own way to a file; none of them may end in a traceback."""
    furnish(tmp_path)
    long = [case for case in cases() if "x" * 5000 in case.words and case.words[0] not in ("export", "devices")]
    wrong = [complaint(case, tmp_path, home.environment) for case in some(long)]
    assert not [found for found in wrong if found]
