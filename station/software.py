"""Which code runs: version of the package and, in a checkout, the git revision."""

from __future__ import annotations

import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

_PACKAGE = "teleop-station"
_GIT_TIMEOUT_S = 2.0


class Software(msgspec.Struct, frozen=True):
    """The code that wrote something.

    Attributes:
        version: Version of the installed package, "" when it is not installed.
        revision: Git revision of the checkout, "" outside one or without git.
        dirty: Whether the checkout had changes that the revision does not name.
    """

    version: str
    revision: str = ""
    dirty: bool = False


@cache
def software() -> Software:
    """Return which code this process runs; never fails, and asks git once."""
    return Software(_version(), *_revision(Path(__file__).resolve().parent.parent))


def _version() -> str:
    try:
        return version(_PACKAGE)
    except PackageNotFoundError:
        return ""


def _revision(folder: Path) -> tuple[str, bool]:
    """Return revision and dirtiness of the checkout that is this folder; a copy inside somebody's checkout has none."""
    if not (folder / ".git").exists():
        return "", False
    revision = _git(folder, "rev-parse", "HEAD")
    if not revision:
        return "", False
    return revision, bool(_git(folder, "status", "--porcelain", "--untracked-files=no"))


def _git(folder: Path, *arguments: str) -> str:
    """Return what git says, or nothing when it is absent, refuses or does not answer in time."""
    try:
        answer = subprocess.run(
            ["git", "-C", str(folder), "--no-optional-locks", *arguments],
            capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip() if answer.returncode == 0 else ""
