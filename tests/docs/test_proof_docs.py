"""What README and the docs say to type is typed, page by page, and what they show is what comes.

``make prove`` writes the values of its run into the pages.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.running import new_home
from tests.docs.pages import PAGES
from tests.docs.reader import Reader
from tests.figures import Figures
from tests.tiers import ROOT


@pytest.mark.assets
@pytest.mark.timeout(1200)
@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_says_can_be_typed_and_what_it_shows_comes(
    tmp_path: Path, page: str, proof: Figures, request: pytest.FixtureRequest
) -> None:
    told = PAGES[page]
    told.prepare(tmp_path)
    with new_home() as home:
        reader = Reader(home if told.has_upstream_data else home.without("STATION_ASSETS"), tmp_path, told.inside)
        typed = reader.read(ROOT / page, told.how, refresh=request.config.getoption("--write-figures"))
    proof.figure(f"{page}: commands that were typed, and did what the page shows", typed)
