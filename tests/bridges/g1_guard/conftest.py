"""What the tests of the guard need: a compiler and Cyclone DDS 0.10 with its IDL compiler; the guard, built once."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.bridges.g1_guard.bench import Bench
from tests.bridges.g1_guard.virtual import Library
from tests.dds_domains import domain
from tests.tiers import ROOT

SOURCE = ROOT / "bridges/g1_guard"
HEADER = Path("/usr/include/dds/dds.h")


@pytest.fixture(scope="session")
def compiler() -> str:
    """The C compiler, with what the guard is built from (tier `build`); a machine without it skips, CI fails."""
    missing = [name for name in ("cc", "make", "idlc") if shutil.which(name) is None]
    missing += [] if HEADER.is_file() else [str(HEADER)]
    if missing:
        message = (
            f"no {', '.join(missing)} to build bridges/g1_guard: apt install gcc make cyclonedds-dev cyclonedds-tools"
        )
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return "cc"


def build(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["make", "-C", str(SOURCE), f"OUT={folder}", *words], capture_output=True, text=True, timeout=100, check=False
    )


@pytest.fixture(scope="session")
def _built(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with `plain/` and `checked/`, the second under sanitizers; processes that run tests share it."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "g1-guard"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = build(folder / "plain", "-j2", "all", "rules")
        assert done.returncode == 0, done.stderr
        checked = build(folder / "checked", "-j2", "SANITIZE=1")
        if "cannot find" in checked.stderr:  # a compiler without these libraries
            checked = build(folder / "checked")
        assert checked.returncode == 0, checked.stderr
    return folder


@pytest.fixture(scope="session")
def library(_built: Path) -> Library:
    """The rules alone, for virtual time."""
    return Library(_built / "plain/librules.so")


@pytest.fixture(scope="session")
def plain(_built: Path) -> Path:
    """The guard as it is installed."""
    return _built / "plain/g1-guard"


@pytest.fixture(scope="session")
def checked(_built: Path) -> Path:
    """The guard, which ends when it touches memory that is not its own, or computes what is undefined."""
    return _built / "checked/g1-guard"


@pytest.fixture(scope="module")
def bench(checked: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """A guard, a robot that it finds, and a client; the tests of a module share it."""
    pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")
    with domain() as number, Bench(checked, number, tmp_path_factory.mktemp("guard")) as made:
        yield made
        made.end()
