"""A headset's browser, and a phone's, drive a robot, from the runbook to the audit (X5)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.bus import codec, keys
from station.protocols import Floats
from tests.adapters.devices.webxr.headset_page import PHONE, HeadsetPage
from tests.cli.running import Home
from tests.main_job.webxr_runs import Worn, drive
from tests.servers.g1_station import LIGHT
from tests.waiting import wait_until
from tests.web import browser as browsers

pytest.importorskip("mink", reason="needs the extra 'retarget'")

pytestmark = pytest.mark.timeout(300)

PATIENT = ("g1.gate.hold_after_s=5.0", "g1.gate.return_after_s=20.0", "g1.gate.blend_in_s=0.2")


@pytest.fixture(scope="module")
def browser(processes: None) -> Iterator[Any]:
    browsers.expect_browser()
    with browsers.driven() as driver, browsers.opened(driver, draws=True) as found:
        yield found


def test_x5_the_palms_of_a_robot_follow_the_hands_in_a_headset(tmp_path: Path, browser: Any, processes: None) -> None:
    worn = Worn(Home(tmp_path), browser, "g1-sim-webxr", *PATIENT, *(f"g1.{each}" for each in LIGHT))
    try:
        wrong_m = drive(worn, 6.0)
        worn.end()
    finally:
        worn.close()
    assert float(np.median(wrong_m[20:])) < 0.06, "the arms lag behind by what the policy does"
    audited = worn.home.json("audit", "latest")
    assert (audited["different"], audited["observations"]["different"], audited["targets"]["different"]) == (0, 0, 0)
    assert audited["steps"] > 100
    checked = worn.home.json("check", "latest")
    assert (checked["dropped"], checked["falls"]) == (0, 0)


def _leads(worn: Worn, page: HeadsetPage, place: Callable[[], Floats]) -> bool:
    """Hold a phone, move it, let go; return whether a tool went along, or else nothing was led to the end."""

    page.do("xr.position.set(0, 1.5, -0.1)")
    start, ended = place(), worn.told("operator-disengaged")
    worn.engage(lambda: page.touch("left"), lambda: page.touch("left", "up"))
    page.do("xr.position.set(0.03, 1.56, -0.15)")  # to the right, up, ahead

    def is_there() -> bool:
        return bool(np.linalg.norm(place() - start - [0.05, -0.03, 0.06]) < 1e-3)

    wait_until(lambda: is_there() or worn.told("operator-disengaged") > ended)
    led = is_there()
    page.touch("left", "up")
    wait_until(lambda: worn.told("operator-disengaged") == worn.told("operator-engaged"))
    page.tab.wait_for_timeout(300)  # what was held has to be seen at rest
    return led


@pytest.mark.usefixtures("kord")
def test_a_phone_in_a_hand_leads_the_tool_of_an_arm_while_a_thumb_holds(
    tmp_path: Path, browser: Any, processes: None
) -> None:
    worn = Worn(Home(tmp_path), browser, "kassow-sim-phone", "teleop.driver=arm-tcp")
    try:
        page = worn.page(emulated=PHONE, size=browsers.PHONE, has_touch=True).enter()
        wait_until(lambda: b'"live"' in (worn.bus.get(keys.operator_status("webxr")) or b""))
        place = lambda: codec.parse_f64(worn.bus.get(keys.state_tcp("kassow_kr810")) or b"")[:3]  # noqa: E731
        start = place()
        page.do("xr.position.set(0, 1.5, -0.1)")
        page.tab.wait_for_timeout(500)
        np.testing.assert_array_equal(place(), start, "without a thumb nothing moves")
        led = False
        for _ in range(8):  # a busy machine may hold a page up, which is let go of then
            led = led or _leads(worn, page, place)
        assert led, worn.station.text
        left = place()
        page.do("xr.position.set(0, 1.5, -0.1)")
        page.tab.wait_for_timeout(500)
        np.testing.assert_allclose(place(), left, atol=1e-3)
        assert page.trouble == []
        page.close()
        worn.end()
    finally:
        worn.close()
    checked = worn.home.json("check", "latest")
    assert (checked["dropped"], checked["audit"]["different"]) == (0, 0), checked["audit"]


def test_a_thumb_on_a_phone_walks_a_robot_and_off_it_the_robot_stands(
    tmp_path: Path, browser: Any, processes: None
) -> None:
    worn = Worn(
        Home(tmp_path), browser, "g1-velocity-phone", "robot.gate.hold_after_s=5.0", "robot.gate.return_after_s=20.0"
    )
    try:
        page = worn.page(emulated="", size=browsers.PHONE, has_touch=True)
        wait_until(lambda: b'"live"' in (worn.bus.get(keys.operator_status("webxr")) or b""))
        box = page.tab.locator("#pad-left").bounding_box()
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        place = lambda: codec.parse_f64(worn.bus.get(keys.sim_qpos("g1_29")) or b"")[:2]  # noqa: E731
        start = place()

        def has_walked() -> bool:
            if worn.told("operator-disengaged") == worn.told("operator-engaged"):  # as a busy machine lets go, too
                page.tab.mouse.up()
                page.tab.mouse.move(*middle)
                worn.engage(page.tab.mouse.down, page.tab.mouse.up)
                page.tab.mouse.move(middle[0], middle[1] - box["height"])
            return bool(np.linalg.norm(place() - start) > 0.5)

        wait_until(has_walked)
        page.do("window.dispatchEvent(new Event('blur'))")  # another window, with the finger still down
        wait_until(lambda: worn.told("operator-disengaged") == worn.told("operator-engaged"))
        page.tab.mouse.up()
        page.close()
        worn.end()
    finally:
        worn.close()
    checked = worn.home.json("check", "latest")
    assert (checked["dropped"], checked["falls"]) == (0, 0)
