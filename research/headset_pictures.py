"""Takes the pictures of docs/webxr.md: `python -m research.headset_pictures`; needs a browser and the extra `test`.

A simulated G1 is driven from Meta's emulator of a headset (IWER), which sees the camera of the robot's head; a phone
has its pads, or is itself the hand.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.adapters.devices.webxr.headset_page import HEADSET, IWER, PHONE

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
PORT, QUALITY = 8792, 82
_UP_S, _SEEN_S = 8.0, 4.0

OVER_A_ROOM = """
document.querySelector("[data-webxr_runtime]").style.display = "none";
document.documentElement.style.background = "linear-gradient(#59636d 62%, #39424b 62%)";
"""
SHOW = """
document.getElementById("scene").hidden = false;
for (const part of ["header", "main", "stop-bar"]) document.getElementById(part).style.visibility = "hidden";
document.body.style.background = "linear-gradient(#59636d 62%, #39424b 62%)";
"""
"""The emulator draws over the page: in place of that there is a room."""


def main() -> None:
    """Take the pictures anew."""
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        own = os.environ | {
            "XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": f"{folder}/state", "STATION_DATA": f"{folder}/data",
        }  # fmt: skip
        station = _begin(own, "up", "g1-sim-webxr", "--yes", "--set", f"webxr.port={PORT}", "--set",
                         "webxr.cameras=[head]", "--set", "teleop.options.sides=[right]")  # fmt: skip
        time.sleep(_UP_S)
        camera = _begin(own, "serve", "camera", "--name", "head", "--set", "source=mujoco")
        try:
            told = subprocess.run(
                [sys.executable, "-m", "station", "pair"], env=own, capture_output=True, text=True, check=True
            )
            link = told.stdout.partition("link ")[2].split()[0]
            browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
            _from_the_headset(browser, link)
            _on_a_phone(browser, link, "webxr-phone.jpg")
            _on_a_phone(browser, link, "webxr-hand.jpg", is_hand=True)
            browser.close()
        finally:
            for process in (camera, station):
                process.terminate()
                process.communicate(timeout=60)


def _begin(environment: dict[str, str], *words: str) -> subprocess.Popen[bytes]:
    nothing = subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-m", "station", *words], env=environment, stdin=nothing, stdout=nothing, stderr=nothing
    )


def _from_the_headset(browser: Any, link: str) -> None:
    page = browser.new_context(viewport={"width": 1280, "height": 640}).new_page()
    page.add_init_script(IWER.read_text(encoding="utf-8") + HEADSET)
    page.goto(link)
    page.click("#enter")
    page.evaluate(f"() => {{ {SHOW} }}")
    page.wait_for_timeout(_SEEN_S * 1e3)
    page.evaluate("() => xr.controllers.right.updateButtonValue('a-button', 1)")
    page.wait_for_timeout(1e3)
    page.screenshot(path=PICTURES / "webxr-headset.jpg", type="jpeg", quality=QUALITY)
    page.close()


def _on_a_phone(browser: Any, link: str, picture: str, *, is_hand: bool = False) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, color_scheme="dark", device_scale_factor=2.0)
    page = context.new_page()
    if is_hand:
        page.add_init_script(IWER.read_text(encoding="utf-8") + PHONE)
    page.goto(link)
    page.wait_for_timeout(_SEEN_S * 1e3)
    if is_hand:
        page.click("#enter")
        page.evaluate(f"() => {{ {OVER_A_ROOM} }}")
        page.wait_for_timeout(_SEEN_S * 1e3)
    box = page.locator("#pad-left").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 12, y - 45)
    page.wait_for_timeout(1e3)
    page.screenshot(path=PICTURES / picture, type="jpeg", quality=QUALITY)
    page.mouse.up()
    context.close()


if __name__ == "__main__":
    main()
