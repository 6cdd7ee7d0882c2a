"""A page that drives, in a browser with IWER's headset, or by a socket without a browser."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.operator import sample as readings
from station.operator.sample import OperatorSample, Status
from station.web.keyring import Keyring
from tests.waiting import wait_until
from tests.web.browser import Page

IWER = Path("tests/web/vendor/iwer.min.js")
INSTALLED = """
xr.installRuntime({forceInstall: true});
Object.defineProperty(XRPose.prototype, "emulatedPosition", {get: () => window.is_guessed === true});
"""
"""IWER says of every grip that its place is only guessed, and of no other pose."""
HEADSET = "window.xr = new IWER.XRDevice(IWER.metaQuest3);" + INSTALLED
PHONE = (
    """
window.xr = new IWER.XRDevice({
  ...IWER.metaQuest3, name: "phone", controllerConfig: undefined, interactionMode: "screen-space",
  supportedSessionModes: ["inline", "immersive-ar"],
  supportedFeatures: ["viewer", "local", "local-floor"], internalNominalFrameRate: 30,
});
"""
    + INSTALLED
    + """
window.overlay = {type: "screen"};
Object.defineProperty(XRSession.prototype, "domOverlayState", {get: () => window.overlay});
"""
)
"""An Android phone, as far as WebXR says what one is: IWER has none, and no page over the room."""


class WebXRServer:
    """``station serve webxr`` on a bus, on a free port.

    Args:
        address: The bus.
        folder: For its words.
        settings: Further ones, ``key=value``.
    """

    def __init__(self, address: BusAddress, folder: Path, *settings: str) -> None:
        self._words = folder / "webxr.txt"
        sets = [word for setting in ("port=0", *settings) for word in ("--set", setting)]
        command = [sys.executable, "-m", "station", "serve", "webxr", "--bus", address.url, *sets]
        with self._words.open("wb") as words:
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=words, stderr=words)
        self.bus = Bus(address, name="test", timeout_s=5.0)
        self.watch = self.bus.watch(readings.watched_keys("webxr"))
        self.url = ""
        wait_until(self._is_there)

    def _is_there(self) -> bool:
        assert self.process.poll() is None, self._words.read_text()
        facts = codec.parse_facts(self.bus.get(keys.server_config("webxr")))
        self.url = str(facts.get("device", {}).get("page", ""))
        return bool(self.url) and self.status is not None

    @property
    def status(self) -> Status | None:
        """What it says of its device."""
        sample = self.watch.latest(keys.operator_status("webxr"))
        return None if sample is None else codec.parse_struct(sample.value, Status)

    @property
    def state(self) -> str:
        """``live``, ``stale`` or ``lost``."""
        return "" if self.status is None else self.status.state

    @property
    def sample(self) -> OperatorSample:
        """The newest sample that may be used."""
        status = self.status
        if status is None or status.state != "live":
            return OperatorSample()
        found = {
            key: sample for key in readings.watched_keys("webxr") if (sample := self.watch.latest(key)) is not None
        }
        return readings.decode("webxr", found)

    @property
    def link(self) -> str:
        """The link that lets a browser in."""
        return f"{self.url}?token={Keyring().token('operator')}"

    def kill(self) -> None:
        """Kill it without a word."""
        self.process.kill()
        self.process.wait()
        self.watch.close()
        self.bus.close()


class HeadsetPage(Page):
    """Its page in a browser that has a headset, or in one that has none."""

    def __init__(self, browser: Any, server: WebXRServer, *, emulated: str = HEADSET, **more: Any) -> None:
        super().__init__(browser, "about:blank", **more)
        if emulated:
            self.context.add_init_script(IWER.read_text(encoding="utf-8") + emulated)
        self.tab.goto(server.link)
        self.until("window.drivePage && drivePage.is_ready")

    def enter(self) -> HeadsetPage:
        """Put the headset on."""
        self.until("drivePage.line.is_up")
        self.tab.locator("#enter").click()
        self.until("drivePage.headset.frames > 5")
        self.do(
            "document.querySelector('[data-webxr_runtime]').style.pointerEvents = 'none'"
        )  # IWER's canvas lies on the page
        return self

    def do(self, statements: str) -> Any:
        """Run statements in the page."""
        return self.tab.evaluate(f"() => {{ {statements} }}")

    def squeeze(self, button: str, side: str = "right", value: float = 1.0) -> None:
        """Press a button of a controller."""
        self.do(f"xr.controllers.{side}.updateButtonValue('{button}', {value})")

    def touch(self, pad: str, kind: str = "down") -> None:
        """Put a thumb of its own on the middle of a pad, or take it off (``up``)."""
        self.tab.locator(f"#pad-{pad}").evaluate(
            """(node, [kind, id]) => {
            const {left, top, width, height} = node.getBoundingClientRect();
            const place = {clientX: left + width / 2, clientY: top + height / 2};
            node.dispatchEvent(new PointerEvent(`pointer${kind}`, {...place, pointerId: id, bubbles: true}));
        }""",
            [kind, 7 if pad == "left" else 8],
        )


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[None]:
    """Have a process stand still."""
    import signal

    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)
