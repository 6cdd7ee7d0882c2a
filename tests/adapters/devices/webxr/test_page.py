"""The page in headless Chromium, with Meta's emulator of a Quest 3 (X1, X2, X5, X6); without a headset, by touch."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.devices.webxr.body import JOINTS as BODY
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.joints import SMPL_24
from station.life import estop
from station.life.stop_button import StopButton
from tests.adapters.devices.webxr.headset_page import HEADSET, PHONE, HeadsetPage, WebXRServer
from tests.waiting import wait_until
from tests.web import browser as browsers
from tests.web.cameras import cameras

pytest.importorskip("starlette", reason="needs the extra 'console'")
pytest.importorskip("playwright", reason="needs playwright, of the extra 'test'")

pytestmark = pytest.mark.timeout(180)

HALF = math.sqrt(0.5)
Open = Callable[..., HeadsetPage]


@pytest.fixture(scope="module")
def browser(processes: None) -> Iterator[Any]:
    """A browser with WebGL, which WebXR needs."""
    browsers.expect_browser()
    with browsers.driven() as driver, browsers.opened(driver, draws=True) as found:
        yield found


@pytest.fixture
def server(
    processes: None, bus_server: BusAddress, tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[WebXRServer]:
    found = WebXRServer(bus_server, tmp_path, *getattr(request, "param", ()))
    yield found
    found.kill()


@pytest.fixture
def open_page(browser: Any, server: WebXRServer) -> Iterator[Open]:
    """Open pages that are closed at the end, and in which nothing went wrong."""
    opened: list[HeadsetPage] = []

    def begin(**more: Any) -> HeadsetPage:
        page = HeadsetPage(browser, server, **more)
        opened.append(page)
        return page

    yield begin
    for page in opened:
        page.close()
    assert [trouble for page in opened for trouble in page.trouble] == []


def test_x1_head_grips_and_buttons_are_those_of_the_headset(server: WebXRServer, open_page: Open) -> None:
    page = open_page().enter()
    page.do(f"""
        xr.position.set(0.2, 1.7, -0.5); xr.quaternion.set(0, {HALF}, 0, {HALF});
        xr.controllers.right.updateAxes('thumbstick', 0.25, -0.75);
        xr.controllers.left.updateButtonValue('trigger', 0.5); xr.controllers.left.updateButtonValue('x-button', 1);
    """)
    grip = page.read("""(() => { const { position: p, quaternion: q } = xr.controllers.right;
        return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]; })()""")
    wait_until(lambda: server.sample.controls.get("left_primary") == 1.0)
    wait_until(lambda: server.sample.head is not None and abs(server.sample.head.position[0] - 0.5) < 1e-4)
    sample = server.sample
    assert sample.head is not None
    assert sample.right is not None
    np.testing.assert_allclose(sample.head.position, [0.5, -0.2, 1.7], atol=1e-5)
    np.testing.assert_allclose(sample.head.quat_wxyz, [HALF, 0.0, 0.0, HALF], atol=1e-5)
    # IWER has the grip within 10 cm of the ray that it is given, which is enough to tell axes apart.
    np.testing.assert_allclose(sample.right.position, [-grip[2], -grip[0], grip[1]], atol=0.1)
    found = {name: value for name, value in sample.controls.items() if value}
    assert found == pytest.approx(
        {"left_trigger": 0.5, "left_primary": 1.0, "right_stick_x": 0.25, "right_stick_y": 0.75}
    )
    told = lambda: codec.parse_facts(server.bus.get(keys.server("webxr")))["detail"]  # noqa: E731
    wait_until(lambda: told().get("right_input") == "meta-quest-touch-plus")
    assert (told()["frames_bad"], told()["frames_old"]) == (0, 0)


def test_x1_hands_have_26_joints_and_a_pinch(server: WebXRServer, open_page: Open) -> None:
    page = open_page().enter()
    page.do("xr.primaryInputMode = 'hand'")
    wait_until(lambda: server.sample.controls.get("left_pinch") == 0.0)
    page.do("xr.hands.left.updatePinchValue(1)")
    wait_until(lambda: set(server.sample.hands) == {"left", "right"})
    wait_until(lambda: server.sample.controls.get("left_pinch", 0.0) > 0.9)
    sample = server.sample
    assert sample.hands["left"].shape == (26, 7)
    assert sample.left is not None
    np.testing.assert_array_equal(sample.left.position, sample.hands["left"][0, :3])
    assert sample.controls["right_pinch"] < 0.5


BODY_OF_A_BROWSER = """
const told = %s, getPose = XRFrame.prototype.getPose;
Object.defineProperty(XRFrame.prototype, "body", {get: () => new Map(Object.keys(told).map((name) => [name, {name}]))});
XRFrame.prototype.getPose = function (space, base) {
  if (!space.name) return getPose.call(this, space, base);
  const [x, y, z] = told[space.name];
  return {transform: {position: {x, y, z}}};
};
"""


def test_x1_a_body_is_sent_where_the_browser_gives_one(server: WebXRServer, open_page: Open) -> None:
    page = open_page()
    places = {name: [0.01 * index, 1.0 + 0.02 * index, -0.03 * index] for index, name in enumerate(BODY)}
    page.do(BODY_OF_A_BROWSER % json.dumps(places))
    page.enter()
    wait_until(lambda: server.sample.body is not None)
    body = server.sample.body
    assert body is not None
    for ours, theirs in (("left_hip", "left-upper-leg"), ("right_wrist", "right-hand-wrist"), ("head", "head")):
        x, y, z = places[theirs]
        np.testing.assert_allclose(body.positions[SMPL_24.index(ours)], [-z, -x, y], atol=1e-6)


LETTING_GO = {
    "the session ends": "drivePage.headset.session.end()",
    "its menu is open": "xr.updateVisibilityState('visible-blurred')",
    "it was taken off": "xr.updateVisibilityState('hidden')",
    "its world was placed anew": "xr.recenter()",
    "a controller was put down": "xr.controllers.right.connected = false",
    "hands came in their place": "xr.primaryInputMode = 'hand'",
    "the page was left": "location.href = 'about:blank'",
}


@pytest.mark.parametrize("how", LETTING_GO)
def test_x2_who_lets_go_holds_nothing(server: WebXRServer, open_page: Open, how: str) -> None:
    page = open_page().enter()
    wait_until(lambda: server.sample.controls.get("right_grip") == 0.0)
    page.squeeze("squeeze")
    wait_until(lambda: server.sample.controls.get("right_grip") == 1.0)
    page.do(LETTING_GO[how])
    wait_until(lambda: server.sample.controls.get("right_grip", 0.0) == 0.0)


def test_x2_a_grip_that_was_held_all_the_while_has_to_be_released_first(server: WebXRServer, open_page: Open) -> None:
    page = open_page().enter()
    page.squeeze("squeeze")
    wait_until(lambda: server.sample.controls.get("right_grip") == 1.0)
    page.do("xr.recenter()")
    wait_until(lambda: server.sample.right is None)
    wait_until(lambda: server.sample.right is not None)
    assert server.sample.controls["right_grip"] == 0.0
    page.squeeze("squeeze", value=0.0)
    page.tab.wait_for_timeout(200)
    page.squeeze("squeeze")
    wait_until(lambda: server.sample.controls.get("right_grip") == 1.0)


def test_x2_a_page_that_hangs_or_is_killed_is_lost(server: WebXRServer, open_page: Open) -> None:
    page = open_page().enter()
    page.squeeze("squeeze")
    wait_until(lambda: server.sample.controls.get("right_grip") == 1.0)
    page.do("setTimeout(() => { const end = Date.now() + 1500; while (Date.now() < end); }, 0)")
    wait_until(lambda: server.state != "live")
    wait_until(lambda: server.state == "live")
    page.tab.close()
    wait_until(lambda: server.state == "lost")
    wait_until(lambda: server.status is not None and "the page is gone" in server.status.reason)


def test_x6_a_second_headset_is_refused_and_says_so(server: WebXRServer, open_page: Open) -> None:
    page = open_page().enter()
    wait_until(lambda: server.state == "live")
    other = open_page()
    other.until("drivePage.line.why === 'another page drives'")
    assert other.tab.locator("#link").text_content() == "another page drives"
    new = server.status.new if server.status is not None else 0
    wait_until(lambda: server.status is not None and server.status.new > new + 10)
    page.close()
    other.until("drivePage.line.is_up")


def test_what_happens_is_felt_and_read(server: WebXRServer, open_page: Open) -> None:
    page = open_page().enter()
    pulses = page.read("drivePage.headset.pulses")
    with contextlib.closing(StopButton(server.bus.address, name="test")) as button:
        button.press("a test")
    page.until("document.querySelector('#cues .urgent')?.textContent === 'emergency stop'")
    assert page.read("drivePage.headset.pulses") >= pulses + 2
    assert page.read("drivePage.headset.scene.words") == "emergency stop"


@pytest.mark.parametrize("server", [("cameras=[head,wrist]",)], indirect=True)
def test_each_eye_has_its_camera(server: WebXRServer, open_page: Open) -> None:
    with cameras(server.bus.address, ("head", "wrist")):
        page = open_page().enter()
        page.until("drivePage.pictures.newest.size === 2 && drivePage.pictures.shown > 20")
        page.until("drivePage.headset.scene.textures.size >= 2")
        assert page.read("drivePage.pictures.of('left') !== drivePage.pictures.of('right')")
        page.until("!drivePage.headset.scene.is_frozen")
        wait_until(lambda: server.state == "live")
    page.until("drivePage.headset.scene.is_frozen")


def test_its_stop_reaches_the_bus(server: WebXRServer, open_page: Open) -> None:
    page = open_page(emulated="")
    page.press_stop()
    page.until("drivePage.sender.press?.taken_at > 0")
    wait_until(lambda: estop.latched(server.bus.read(estop.KEYS).get) is not None)
    assert page.tab.locator("#stop-word").text_content() == "taken"


def test_a_thumb_drives_while_it_is_on_the_pad(server: WebXRServer, open_page: Open) -> None:
    page = open_page(emulated="", size=browsers.PHONE, has_touch=True)
    page.until("drivePage.line.is_up")
    box = page.tab.locator("#pad-left").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.tab.mouse.move(*middle)
    page.tab.mouse.down()
    page.tab.mouse.move(middle[0], middle[1] - box["height"])
    wait_until(lambda: server.sample.controls.get("left_stick_y", 0.0) > 0.49)
    assert server.sample.controls["touch_hold"] == 1.0
    assert server.sample.controls["left_stick_y"] == pytest.approx(0.5, abs=1e-3), "half of a gamepad's"
    page.tab.mouse.up()
    wait_until(lambda: server.sample.controls.get("touch_hold") == 0.0)
    assert server.sample.controls["left_stick_y"] == 0.0


@pytest.fixture
def phone(open_page: Open) -> HeadsetPage:
    """A phone that is itself the hand."""
    return open_page(emulated=PHONE, size=browsers.PHONE, has_touch=True).enter()


def test_a_phone_is_itself_the_right_hand_while_a_thumb_holds(server: WebXRServer, phone: HeadsetPage) -> None:
    phone.do(f"xr.position.set(0.2, 1.1, -0.5); xr.quaternion.set(0, {HALF}, 0, {HALF})")
    wait_until(lambda: server.sample.right is not None and abs(server.sample.right.position[0] - 0.5) < 1e-4)
    sample = server.sample
    assert sample.right is not None
    np.testing.assert_allclose(sample.right.position, [0.5, -0.2, 1.1], atol=1e-5)
    np.testing.assert_allclose(sample.right.quat_wxyz, [HALF, 0.0, 0.0, HALF], atol=1e-5)
    assert (sample.head, sample.left, sample.controls["touch_hold"]) == (None, None, 0.0)
    phone.touch("left")
    phone.touch("right")
    wait_until(lambda: server.sample.controls.get("touch_hold") == 1.0)
    wait_until(lambda: server.sample.controls.get("right_trigger") == 1.0)
    phone.touch("right", "up")
    wait_until(lambda: server.sample.controls.get("right_trigger") == 0.0)
    assert server.sample.controls["touch_hold"] == 1.0
    phone.touch("left", "up")
    wait_until(lambda: server.sample.controls.get("touch_hold") == 0.0)
    told = lambda: codec.parse_facts(server.bus.get(keys.server("webxr")))["detail"]  # noqa: E731
    wait_until(lambda: told().get("right_input") == "phone")


def test_a_touch_is_no_controller_that_came(server: WebXRServer, phone: HeadsetPage) -> None:
    """A browser tells of each touch of the screen, and of each pinch where somebody looks, as of a new input."""
    phone.touch("left")
    wait_until(lambda: server.sample.controls.get("touch_hold") == 1.0)
    phone.do("""for (const targetRayMode of ["screen", "transient-pointer"]) {
        const told = {added: [{targetRayMode, handedness: "right"}], removed: []};
        drivePage.headset.session.dispatchEvent(Object.assign(new Event("inputsourceschange"), told));
    }""")
    phone.tab.wait_for_timeout(300)
    assert server.sample.controls["touch_hold"] == 1.0
    assert "let go" not in phone.tab.locator("#cues").text_content()


def test_x2_a_phone_that_leaves_the_room_holds_nothing(server: WebXRServer, phone: HeadsetPage) -> None:
    phone.touch("left")
    wait_until(lambda: server.sample.controls.get("touch_hold") == 1.0)
    phone.tab.get_by_role("button", name="Leave").click()
    wait_until(lambda: server.sample.controls.get("touch_hold") == 0.0)
    phone.tab.wait_for_timeout(300)
    assert server.sample.controls["touch_hold"] == 0.0
    assert server.sample.right is None


@pytest.mark.parametrize("emulated", [PHONE, HEADSET], ids=["a phone", "a headset"])
def test_a_place_that_is_only_guessed_leads_no_hand(server: WebXRServer, open_page: Open, emulated: str) -> None:
    page = open_page(emulated=emulated).enter()
    wait_until(lambda: server.sample.right is not None)
    page.do("window.is_guessed = true")
    wait_until(lambda: server.state == "live" and server.sample.right is None)
    assert "right_trigger" in server.sample.controls, "its buttons are as good as before"


def test_a_phone_without_the_stop_in_view_is_no_hand(server: WebXRServer, open_page: Open) -> None:
    page = open_page(emulated=PHONE, size=browsers.PHONE)
    page.do("window.overlay = null")
    page.until("drivePage.line.is_up")
    page.tab.locator("#enter").click()
    page.until("document.querySelector('#cues .urgent')?.textContent.includes('no stop in view')")
    assert page.read("drivePage.headset.session === null && drivePage.headset.frames === 0")


def test_nobody_is_left_out_by_a_phone_in_the_hand(phone: HeadsetPage) -> None:
    assert phone.violations() == []
    assert [phone.tab.locator(each).is_visible() for each in ("#stop", "#pad-left", "#pad-right", "#enter")] == [
        True
    ] * 4
    assert phone.read("document.documentElement.scrollHeight <= innerHeight")
    phone.press_stop()
    phone.until("drivePage.sender.press?.taken_at > 0")


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("size", [browsers.DESKTOP, browsers.PHONE, browsers.SMALL])
def test_nobody_is_left_out(server: WebXRServer, open_page: Open, size: tuple[int, int], theme: str) -> None:
    page = open_page(emulated="", size=size, color_scheme=theme)
    assert page.violations() == []
    assert page.tab.locator("#stop").is_visible()
    wide = page.read("[document.documentElement.scrollWidth, innerWidth]")
    assert wide[0] <= wide[1]


def test_a_code_lets_a_headset_in(server: WebXRServer, browser: Any) -> None:
    from station.web.keyring import Keyring

    page = browsers.Page(browser, server.url)
    try:
        assert page.violations() == []
        page.tab.fill("#code", "0000 0000")
        page.tab.get_by_role("button", name="Sign in").click()
        page.until("document.getElementById('pair-note').textContent.startsWith('not the code of now')")
        code = Keyring().code(time.time())
        page.tab.fill("#code", f"{code[:4]} {code[4:]}")
        page.tab.get_by_role("button", name="Sign in").click()
        page.tab.wait_for_selector("#pad-left")
        page.until("window.drivePage && drivePage.line.is_up")
    finally:
        page.close()
