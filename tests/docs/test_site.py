"""The site of the docs: every page is in it, every link leads somewhere, and the Python API says what it takes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tiers import ROOT

pytestmark = pytest.mark.usefixtures("processes")


def test_it_is_built_without_a_warning_and_without_the_network(tmp_path: Path) -> None:
    made = tmp_path / "site"
    subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-b", "html", "-W", "--keep-going", "-d", str(tmp_path / "cache"),
         str(ROOT / "docs"), str(made)],
        check=True,
    )  # fmt: skip
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    assert pages <= {path.stem for path in made.glob("*.html")}
    first = (made / "index.html").read_text(encoding="utf-8")
    assert 'href="first-episode.html"' in first
    assert not [name for name in sorted(pages - {"index"}) if f'href="{name}.html"' not in first], (
        "in the list of pages"
    )
    api = (made / "api.html").read_text(encoding="utf-8")
    for name in ("Station.follow", "Record.start", "Episode.numpy", "Episode.steps"):
        assert re.search(rf'id="station\.api\.\w+\.{re.escape(name)}"', api), name
    fetched = re.compile(r"""<(?:script|link|img)[^>]+(?:src|href)=["']https?://""")
    assert not [path.name for path in made.glob("*.html") if fetched.search(path.read_text(encoding="utf-8"))]
