"""The wheel of this checkout, installed where nothing of the checkout can be found."""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

from tests.cli.running import Home

ROOT = Path(__file__).parents[1]


def build(folder: Path) -> Path:
    """Build the wheel into a folder; return its path."""
    _pip("wheel", str(ROOT), "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", str(folder))
    (built,) = folder.glob("*.whl")
    return built


def install(wheel: Path, folder: Path) -> Path:
    """Install a wheel into a new environment whose other packages are those of the tests; return its interpreter."""
    venv.create(folder)
    made = folder / "bin" / "python"
    (site,) = folder.glob("lib/python*/site-packages")
    _pip("--python", str(made), "install", "--no-deps", "--no-index", "--no-compile", str(wheel))
    # Of a folder that a .pth names no .pth is read: the checkout stays unknown.
    (site / "dependencies.pth").write_text("\n".join(path for path in sys.path if path.endswith("-packages")))
    return made


def use(home: Home, python: Path) -> None:
    """Let a home's `station` be that of an environment, without upstream data."""
    home.environment = {name: value for name, value in home.environment.items() if name != "PYTHONPATH"}
    home.environment["PATH"] = f"{python.parent}:{home.environment['PATH']}"
    home.environment.pop("STATION_ASSETS", None)


def _pip(*arguments: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
