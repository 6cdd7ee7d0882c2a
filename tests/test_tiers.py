"""What a test uses decides its tier, a unit test that starts a process fails, and a run leaves no temporary files."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests import workers
from tests.tiers import ROOT, NotInItsTier

COMMAND = [sys.executable, "-I", "-S", "-c", ""]


def test_a_unit_test_that_starts_a_process_fails() -> None:
    with pytest.raises(NotInItsTier, match="a unit test starts a process"):
        subprocess.run(COMMAND, check=True)


def test_a_library_may_start_one_when_it_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "asks_for_a_version.py").write_text(f"import subprocess\nsubprocess.run({COMMAND!r}, check=True)\n")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("asks_for_a_version")


@pytest.mark.parametrize(
    ("processors", "additions_s", "expected"), [(2, 0.03, 4), (2, 0.07, 2), (1, 0.03, 2), (1, 0.07, 1), (16, 0.07, 4)]
)
def test_a_slow_machine_runs_one_process_of_tests_a_processor(
    processors: int, additions_s: float, expected: int
) -> None:
    assert workers.count(processors, additions_s) == expected


def test_one_process_has_all_robot_twins_in_real_time() -> None:
    split = workers.OneTwinAtATime.__new__(workers.OneTwinAtATime)._split_scope
    twins = {split(f"tests/bridges/g1_guard/test_{name}.py::test[a::b]") for name in ("station", "deployment")}
    assert twins == {split("tests/main_job/test_real_g1.py::test_x")}
    assert split("tests/test_tiers.py::test_x") == "tests/test_tiers.py"


def test_a_run_leaves_no_temporary_files_to_the_next_one(processes: None) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "frozen"]
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:  # a path that is short enough for sockets below it
        environment = os.environ | {"TMPDIR": folder, "PYTEST_DEBUG_TEMPROOT": folder}
        done = subprocess.run(
            [*command, "tests/life/test_stop_line.py"],
            cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        assert [path.name.partition("-")[0] for path in Path(folder).iterdir()] == ["pytest"]
