"""What the tests that compile need: a compiler, and CMake, which may be only in the environment of this Python."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[3] / "bridges/kord"


def environment() -> dict[str, str]:
    """Return this process's, with the programs of this Python's environment; without a compiler skip, fail in CI."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    for program in ("c++", "cmake"):
        if shutil.which(program, path=path) is None:
            message = f"there is no {program} to build bridges/kord with"
            if os.environ.get("CI"):
                pytest.fail(message)
            pytest.skip(message)
    return {**os.environ, "PATH": path}
