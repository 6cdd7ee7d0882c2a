"""Python processes that we start, in a folder with modules that are called like Python's own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from station import python_child

_LIKE_THE_STATION_COMMAND = """
import math, sys
from station import side_by_side
from station.cli.main import main

if __name__ == "__main__":
    sys.argv = ["station", "--version"]
    try:
        main()
    except SystemExit as end:
        assert end.code == 0
    print(side_by_side.run(math.sqrt, [1.0, 4.0], jobs=2))
"""

_MULTIPLIES = """
import os, sys
from station.cli.main import main

sys.argv = ["station", "--version"]
try:
    main()
except SystemExit as end:
    assert end.code == 0
import numpy
numpy.ones((400, 400)) @ numpy.ones((400, 400))
print(os.environ["OPENBLAS_NUM_THREADS"], len(os.listdir("/proc/self/task")))
"""


_IMPORTS = """
import gc, sys
from station import registry
from station.cli.main import main

before = gc.get_freeze_count()
if sys.argv[1] == "a library":
    registry.find("server", "g1")
else:
    sys.argv = ["station", "settings", "g1"]
    try:
        main()
    except SystemExit as end:
        assert end.code == 0
print(gc.get_freeze_count() - before > 10_000, gc.isenabled())
"""


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A folder whose modules end the process that imports them; multiprocessing imports `socket`."""
    folder = tmp_path / "here"
    folder.mkdir()
    for module in ("socket", "secrets"):
        (folder / f"{module}.py").write_text(f"raise SystemExit('the {module} of this folder was imported')")
    return folder


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != python_child.SAFE_PATH}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.usefixtures("processes")
def test_a_child_imports_no_module_of_the_current_folder(hostile: Path) -> None:
    done = run(python_child.command("-c", "import secrets, multiprocessing.reduction"), hostile)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.usefixtures("processes")
def test_the_command_line_protects_the_processes_that_share_its_work(hostile: Path, tmp_path: Path) -> None:
    script = tmp_path / "station_command.py"
    script.write_text(_LIKE_THE_STATION_COMMAND)
    done = run([sys.executable, str(script)], hostile)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("[1.0, 2.0]\n")


@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize(("given", "has"), [({}, "1 1"), ({python_child.BLAS_THREADS: "2"}, "2 2")])
def test_the_command_line_multiplies_in_one_thread_unless_the_user_wants_more(given: dict[str, str], has: str) -> None:
    if int(has[0]) > len(os.sched_getaffinity(0)):
        pytest.skip("NumPy takes no more threads than there are processors")
    environment = {name: value for name, value in os.environ.items() if name != python_child.BLAS_THREADS} | given
    done = subprocess.run(
        [sys.executable, "-B", "-c", _MULTIPLIES], env=environment, capture_output=True, text=True, check=True
    )  # cold
    assert done.stdout.splitlines()[-1] == has


@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("caller", ["a library", "the command"])
def test_what_a_command_imports_is_not_searched_for_what_can_be_freed_and_a_library_leaves_the_collector_alone(
    caller: str, tmp_path: Path
) -> None:
    cold = {**os.environ, "PYTHONHASHSEED": "0"}
    command = python_child.command("-c", _IMPORTS, caller)
    done = subprocess.run(command, cwd=tmp_path, env=cold, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == f"{caller == 'the command'} True"
