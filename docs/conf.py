"""The site of these pages: `make docs` builds it into site/, without the network."""  # noqa: INP001 - Sphinx reads it

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"\[([^\]]+)\]\(([^)#:]+)\)")

project = "Teleop Station"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = project
html_show_copyright = False

myst_heading_anchors = 3  # a link to a heading of another page

autodoc_default_options = {"members": True, "member-order": "bysource"}
napoleon_attr_annotations = False


def _name_files(_app: object, place: Path | str, _parent: object, text: list[str]) -> None:
    """Let a link to a file of the repository that is no page here be that file's name."""
    folder = ROOT if Path(place).name == "README.md" else ROOT / "docs"

    def named(link: re.Match[str]) -> str:
        file = (folder / link[2]).resolve()
        is_elsewhere = file.is_file() and not file.is_relative_to(ROOT / "docs")
        return f"{link[1]} (`{file.relative_to(ROOT)}`)" if is_elsewhere else link[0]

    text[0] = _LINK.sub(named, text[0])


def setup(app: Any) -> None:
    """Connect what is above."""
    app.connect("include-read", _name_files)
    app.connect("source-read", lambda app, name, text: _name_files(app, name, name, text))
