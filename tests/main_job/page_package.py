"""A package whose files stand in a page of the docs, installed beside the station as an installer leaves it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from tests.main_job.station_runs import ROOT, Terminal

_NOT_INSTALLED = ("pyproject.toml", ".yaml")


def files(page: str, package: str) -> dict[str, str]:
    """Return the files of a package by name, as a page of `docs/` shows them."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    shown = re.finditer(rf"^`{re.escape(package)}/([\w.-]+)`\n\n```\w+\n(.*?)^```", text, re.DOTALL | re.M)
    return {found[1]: found[2] for found in shown}


def install(page: str, package: str, folder: Path) -> Terminal:
    """Return a user's terminal in whose Python the package is installed."""
    shown = files(page, package)
    project = tomllib.loads(shown["pyproject.toml"])["project"]
    site = folder / "site"
    metadata = site / f"{package.replace('-', '_')}-{project['version']}.dist-info"
    metadata.mkdir(parents=True)
    for name, text in shown.items():
        if not name.endswith(_NOT_INSTALLED):
            (site / name).write_text(text)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {project['version']}\n")
    lines = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")
    terminal = Terminal(folder / "station")
    terminal.environment["PYTHONPATH"] = str(site)
    return terminal
