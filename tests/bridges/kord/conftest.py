"""What the tests that compile need: a compiler, and CMake, which may be only in the environment of this Python."""

from __future__ import annotations

import os
import shutil
import sys

import pytest


@pytest.fixture(scope="session")
def compiler() -> dict[str, str]:
    """The environment to compile bridges/kord in (tier `build`); without a compiler skip, fail in CI."""
    path = f"{os.path.dirname(sys.executable)}{os.pathsep}{os.environ.get('PATH', '')}"
    for program in ("c++", "cmake"):
        if shutil.which(program, path=path) is None:
            message = f"there is no {program} to build bridges/kord with"
            if os.environ.get("CI"):
                pytest.fail(message)
            pytest.skip(message)
    return {**os.environ, "PATH": path}
