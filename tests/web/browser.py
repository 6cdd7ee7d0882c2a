"""A real browser that opens pages of a console: Debian's headless Chromium, driven by Playwright."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.waiting import wait_until

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
NO_BROWSER = "needs a browser: apt-get install chromium-headless-shell"
AXE = Path(__file__).with_name("vendor") / "axe.min.js"
DESKTOP, TABLET, PHONE, SMALL = (1440, 900), (820, 1180), (390, 844), (320, 568)


def expect_browser() -> str:
    """Return the program of a browser; a machine without one skips, CI fails."""
    found = next((path for name in PROGRAMS if (path := shutil.which(name))), None)
    if found is None:
        if os.environ.get("CI"):
            pytest.fail(NO_BROWSER)
        pytest.skip(NO_BROWSER)
    return found


@contextlib.contextmanager
def driven() -> Iterator[Any]:
    """Give what drives browsers; a thread may have one of these."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright, of the extra 'test'")
    with playwright.sync_playwright() as driver:
        yield driver


@contextlib.contextmanager
def opened(driver: Any, niceness: int = 15, *, draws: bool = False) -> Iterator[Any]:
    """Give a browser.

    Args:
        driver: Of `driven`.
        niceness: How far it stands back behind what other tests run: a robot twin beside it has 0.1 s for a state.
        draws: Whether it has WebGL: without a GPU it draws on the processors, all that there are.
    """
    program = expect_browser()
    with tempfile.TemporaryDirectory() as folder:
        standing_back = Path(folder) / "browser"
        standing_back.write_text(f'#!/bin/sh\nexec nice -n {niceness} {shlex.quote(program)} "$@"\n')
        standing_back.chmod(0o700)
        browser = driver.chromium.launch(
            executable_path=standing_back, args=["--no-sandbox", *([] if draws else ["--disable-3d-apis"])]
        )
        try:
            yield browser
        finally:
            browser.close()


class Page:
    """A page of a console in a browser, with what went wrong in it.

    Args:
        browser: Of `opened`.
        link: What it opens.
        size: Of the window [px].
        more: Of the browser's context.
    """

    def __init__(self, browser: Any, link: str, size: tuple[int, int] = DESKTOP, **more: Any) -> None:
        self.context = browser.new_context(viewport={"width": size[0], "height": size[1]}, **more)
        self.tab = self.context.new_page()
        self.trouble: list[str] = []
        self.asked: list[str] = []
        self.tab.on("pageerror", lambda error: self.trouble.append(str(error)))
        self.tab.on("dialog", lambda dialog: self.trouble.append(f"dialog: {dialog.message}"))
        self.tab.on("console", self._on_console)
        self.context.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(link)

    def _on_console(self, message: Any) -> None:
        if message.type == "error" and "Content Security Policy" in message.text:
            self.trouble.append(message.text)

    def read(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        return self.tab.evaluate(f"() => ({expression})")

    def until(self, expression: str, timeout_s: float = 30.0) -> Any:
        """Return the value of an expression as soon as it is true."""
        found: list[Any] = [None]

        def holds() -> bool:
            found[0] = self.read(expression)
            return bool(found[0])

        try:
            wait_until(holds, timeout_s)
        except AssertionError:
            state = self.read("({stop: window.stationPage?.stop, link: window.stationPage?.link})")
            raise AssertionError(f"never so: {expression}; {state}; {self.trouble}") from None
        return found[0]

    def ready(self) -> Page:
        """Wait until it has been told of a station."""
        self.until("window.stationPage && stationPage.state && stationPage.state.bus.linked")
        self.until("stationPage.is_known && stationPage.is_ready")
        return self

    @property
    def stop_kind(self) -> str:
        """What the stop's bar says, as its kind."""
        return str(self.read("stationPage.stop.kind"))

    def press_stop(self) -> None:
        """Put a finger, or the mouse, on the stop."""
        box = self.tab.locator("#stop").bounding_box()
        self.tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.tab.mouse.down()
        self.tab.mouse.up()

    def hold(self, selector: str, seconds: float) -> None:
        """Hold a button down for so long."""
        self.tab.locator(selector).scroll_into_view_if_needed()
        box = self.tab.locator(selector).bounding_box()
        self.tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.tab.mouse.down()
        self.tab.wait_for_timeout(seconds * 1e3)
        self.tab.mouse.up()

    def violations(self) -> list[Any]:
        """Return what keeps somebody from using it, as axe finds it; a page with a policy needs ``bypass_csp``."""
        self.tab.evaluate(AXE.read_text(encoding="utf-8"))
        found = "async () => (await axe.run()).violations.map(v => [v.id, v.nodes.map(n => n.html)])"
        return list(self.tab.evaluate(found))

    def close(self) -> None:
        """Close it."""
        self.context.close()
