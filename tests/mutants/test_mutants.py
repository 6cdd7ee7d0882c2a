"""The list of mutants fits the code of today, and its runner tells a test that notices from one that is blind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants.__main__ import FOLDER, ROOT, main
from tests.mutants.mutant import LINT_IMPORTS, load
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")

MUTANT = """
- name: {name}
  why: The sum would be wrong.
  file: sums.py
  old: "{old}"
  new: "{new}"
  caught_by: [test_sums.py]
"""


def test_every_mutant_fits_the_code_of_today_and_names_tests_that_exist() -> None:
    wrong = []
    for mutant in load(FOLDER):
        if stale := mutant.why_stale(ROOT):
            wrong.append(f"{mutant.name}: {stale}")
        for catcher in mutant.caught_by:
            file, _, test = catcher.partition("::")
            path = ROOT / file
            names = re.findall(r"\b(?:def|class) (\w+)", path.read_text(encoding="utf-8")) if path.is_file() else []
            if catcher != LINT_IMPORTS and (not names or (test and test.partition("[")[0] not in names)):
                wrong.append(f"{mutant.name}: there is no {catcher}")
    assert wrong == []


def test_there_are_mutants_of_every_folder_of_the_product() -> None:
    files = [mutant.file for mutant in load(FOLDER)]
    assert len(files) >= 40
    rooms = [f"station/{path.name}/" for path in (ROOT / "station").iterdir() if (path / "__init__.py").is_file()]
    assert [
        room for room in (*rooms, "adapters/", "servers/", "bridges/") if not any(f.startswith(room) for f in files)
    ] == []


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small repository, with mutants beside its only test."""
    (tmp_path / "sums.py").write_text("def add(one, other):\n    return one + other\n\n\nUNUSED = 1\n")
    (tmp_path / "test_sums.py").write_text("import sums\n\n\ndef test_a_sum():\n    assert sums.add(2, 2) == 4\n")
    return tmp_path


def listed(tree: Path, **mutants: tuple[str, str]) -> Path:
    folder = tree / "listed"
    folder.mkdir()
    text = "".join(MUTANT.format(name=name, old=old, new=new) for name, (old, new) in mutants.items())
    (folder / "sums.yaml").write_text(text)
    return folder


def test_a_mutant_that_a_test_notices_is_caught(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = listed(tree, minus=("one + other", "one - other"))
    assert main(["--jobs", "1"], tree, folder) == 0
    said = capsys.readouterr().out
    assert re.search(r"^minus +\d+\.\d s  test_sums\.py::test_a_sum$", said, re.MULTILINE)
    assert "1 of 1 caught" in said
    assert "one + other" in (tree / "sums.py").read_text(), "only a copy was changed"


def test_one_that_survives_is_stale_or_breaks_its_tests_fails_the_run_in_a_line(
    tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mutants = {
        "times": ("one + other", "one * other"),
        "gone": ("one - other", "one"),
        "twice": ("other", "one"),
        "broken": ("UNUSED = 1", "UNUSED = ("),
    }
    assert main(["--jobs", "2"], tree, listed(tree, **mutants)) == 1
    said = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "SURVIVED: test_sums.py did not notice: The sum would be wrong." in said["times"]
    assert "STALE: its old text stands 0 times in sums.py, not once" in said["gone"]
    assert "STALE: its old text stands 2 times in sums.py" in said["twice"]
    assert "ERROR: the tests did not run with the patch (exit code 2)" in said["broken"]
    assert "0 of 4 caught" in "".join(said.values())


def test_tests_that_fail_without_a_patch_prove_nothing(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tree / "test_sums.py").write_text("def test_a_sum():\n    assert 2 + 2 == 5\n")
    assert main(["--jobs", "1"], tree, listed(tree, minus=("one + other", "one - other"))) == 1
    assert "ERROR: test_sums.py::test_a_sum fails without the patch" in capsys.readouterr().out


def test_an_interrupt_ends_the_tests_that_run_and_leaves_nothing_behind(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.mutants", "--only", "hold-after-300-ms", "--jobs", "1"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True) as running:
        wait_until(lambda: list(tmp_path.glob("mutants-*/clean/tests/control/__pycache__/*")))  # pytest is at work
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=DEADLINE_S)
    assert (running.returncode, said.splitlines()[-1]) == (130, "stopped")
    assert list(tmp_path.glob("mutants-*")) == []


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"new": "one + other"}, "changes nothing"),
        ({"caught_by": "[lint-imports, test_sums.py]"}, "lint-imports alone"),
        ({"caught_by": "[]"}, "caught_by names tests"),
        ({"files": "x"}, "unknown field `files`"),
    ],
)
def test_a_mutant_that_is_none_is_refused_with_its_file(tmp_path: Path, changed: dict[str, str], told: str) -> None:
    fields = {
        "name": "a",
        "why": "b",
        "file": "sums.py",
        "old": "one + other",
        "new": "x",
        "caught_by": "[test_sums.py]",
    }
    lines = [f"{name}: {value}" for name, value in (fields | changed).items()]
    (tmp_path / "odd.yaml").write_text("- " + "\n  ".join(lines) + "\n")
    with pytest.raises(ValueError, match=rf"odd\.yaml: .*{told}"):
        load(tmp_path)
