"""Takes the pictures of docs/console.md: `python -m research.console_pictures`; needs a browser and the extra `test`.

A simulated G1 walks, a camera looks from its head, an episode is recorded, and the page is photographed as on a
desktop, a tablet and a phone, in both themes.
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

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
RUNBOOK, PORT = "g1-sim-cameras", 8791
QUALITY = 82
_UP_S, _SEEN_S = 12.0, 9.0

VIEWS = {
    "console-desktop": ((1440, 900), "dark", 1.0),
    "console-light": ((1440, 900), "light", 1.0),
    "console-tablet": ((820, 1180), "light", 1.0),
    "console-phone": ((390, 844), "dark", 2.0),
}
"""Size of the window [px], theme, and pixels for each of its pixels, by the name of the picture."""


def main() -> None:
    """Take all pictures anew."""
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        own = {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": f"{folder}/state", "STATION_DATA": f"{folder}/data"}
        command = [sys.executable, "-m", "station", "up", RUNBOOK, "--yes", "--console", "--record", "--task", "carry",
                   "--set", f"console.port={PORT}", "--set", "motion.loop=true"]  # fmt: skip
        station = subprocess.Popen(
            command, env=os.environ | own, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True,
        )  # fmt: skip
        try:
            assert station.stdout is not None
            link = station.stdout.readline().partition(": ")[2].strip()
            time.sleep(_UP_S)
            browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
            for name, view in VIEWS.items():
                _photograph(browser, link, name, *view)
            browser.close()
        finally:
            station.terminate()
            station.communicate(timeout=60)


def _photograph(browser: Any, link: str, name: str, size: tuple[int, int], theme: str, scale: float) -> None:
    width, height = size
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=theme, device_scale_factor=scale
    )
    page = context.new_page()
    page.goto(link)
    page.wait_for_timeout(_SEEN_S * 1e3)
    page.screenshot(path=PICTURES / f"{name}.jpg", type="jpeg", quality=QUALITY)
    context.close()


if __name__ == "__main__":
    main()
