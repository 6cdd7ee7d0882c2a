"""A minute in a headset: no sample is lost, the robot's palms are where the hands lead them, the audit finds no bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.bus import codec, keys
from tests.cli.running import Home
from tests.figures import Figures
from tests.main_job.webxr_runs import Worn, drive
from tests.web import browser as browsers

pytest.importorskip("mink", reason="needs the extra 'retarget'")

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def browser(processes: None) -> Iterator[Any]:
    browsers.expect_browser()
    with browsers.driven() as driver, browsers.opened(driver, draws=True) as found:
        yield found


def test_x1_x5_sixty_seconds_without_a_lost_sample(
    tmp_path: Path, browser: Any, processes: None, proof: Figures
) -> None:
    worn = Worn(Home(tmp_path), browser, "g1-sim-webxr")
    try:
        wrong_m = drive(worn, 60.0)
        told = codec.parse_facts(worn.bus.get(keys.server("webxr")))["detail"]
        status = codec.parse_facts(worn.bus.get(keys.operator_status("webxr")))
        worn.end()
    finally:
        worn.close()
    assert (told["frames_bad"], told["frames_old"]) == (0, 0)
    assert status["new"] > 50 * 60
    audited = worn.home.json("audit", "latest")
    assert (audited["different"], audited["observations"]["different"], audited["targets"]["different"]) == (0, 0, 0)
    proof.figure("WebXR: samples in 60 s", float(status["new"]), "")
    proof.figure("WebXR: palms from where the hands lead them, p50", float(np.median(wrong_m)) * 1e3, "mm")
    proof.figure("WebXR: palms from where the hands lead them, p95", float(np.quantile(wrong_m, 0.95)) * 1e3, "mm")
