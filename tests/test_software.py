from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from station.software import software

pytestmark = pytest.mark.usefixtures("processes")

SAY = (
    "from station import software; software._GIT_TIMEOUT_S = 60.0; s = software.software();"
    "print(repr(s.version), repr(s.revision), s.dirty)"
)


def copy_of_the_package(folder: Path) -> Path:
    """A copy outside any checkout, so that what git would say is chosen here."""
    package = Path(__file__).parent.parent / "station"
    (folder / "station").mkdir()
    for name in ("__init__.py", "software.py"):
        shutil.copy(package / name, folder / "station" / name)
    return folder


def said_in(folder: Path, **environment: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", SAY], cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True,
        check=True, timeout=60,
    )  # fmt: skip
    return done.stdout.split()


def test_the_running_code_names_its_version() -> None:
    assert software().version


def test_without_git_or_outside_a_checkout_there_is_no_revision_and_no_failure(tmp_path: Path) -> None:
    folder = copy_of_the_package(tmp_path)
    assert said_in(folder)[1:] == ["''", "False"]
    (folder / ".git").mkdir()
    assert said_in(folder, PATH="/nowhere")[1:] == ["''", "False"]
    assert said_in(folder)[1:] == ["''", "False"]  # a .git that is none


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_in_a_checkout_the_revision_and_its_changes_are_named(tmp_path: Path) -> None:
    folder = copy_of_the_package(tmp_path)
    git = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    subprocess.run([*git, "init", "-q"], check=True, timeout=60)
    subprocess.run([*git, "add", "."], check=True, timeout=60)
    subprocess.run([*git, "commit", "-q", "-m", "x"], check=True, timeout=60)
    _, revision, dirty = said_in(folder)
    assert len(revision.strip("'")) == 40
    assert dirty == "False"
    (folder / "station" / "__init__.py").write_text("changed = True\n")
    assert said_in(folder)[1:] == [revision, "True"]
