"""What a test uses decides its tier: one of the unit tier that starts a process fails."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tiers import NotInItsTier

COMMAND = [sys.executable, "-I", "-S", "-c", ""]


def test_a_unit_test_that_starts_a_process_fails() -> None:
    with pytest.raises(NotInItsTier, match="a unit test starts a process"):
        subprocess.run(COMMAND, check=True)


def test_a_library_may_start_one_when_it_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "asks_for_a_version.py").write_text(f"import subprocess\nsubprocess.run({COMMAND!r}, check=True)\n")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("asks_for_a_version")
