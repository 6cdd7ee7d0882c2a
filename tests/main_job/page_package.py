"""A package whose files stand in a page of the docs, installed by pip."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from tests.main_job.station_runs import ROOT, Terminal


def files(page: str, package: str) -> dict[str, str]:
    """Return the files of a package by name, as a page of `docs/` shows them."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    shown = re.finditer(rf"^`{re.escape(package)}/([\w./-]+)`\n\n```\w+\n(.*?)^```", text, re.DOTALL | re.M)
    return {found[1]: found[2] for found in shown}


def install(page: str, package: str, folder: Path) -> Terminal:
    """Write a package to a folder and install it; return a user's terminal whose Python has it.

    Whatever else was installed into the folder is there as well. What the package needs has to be there already.
    """
    for name, text in files(page, package).items():
        file = folder / package / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "install", "--no-index", "--no-deps"]
    subprocess.run(
        [*pip, "--no-build-isolation", "--target", str(folder / "site"), str(folder / package)],
        check=True, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    terminal = Terminal(folder / "station")
    terminal.environment["PYTHONPATH"] = str(folder / "site")
    return terminal
