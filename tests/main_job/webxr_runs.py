"""A station whose operator wears the headset of a browser, or has a phone: driven, and measured."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station.bus import codec, keys
from station.bus.client import Bus
from station.protocols import Floats
from station.web.keyring import Keyring
from tests.adapters.devices.webxr.headset_page import HeadsetPage
from tests.cli.running import Home, Running
from tests.servers.g1_station import ROBOT
from tests.waiting import wait_until

pytest.importorskip("starlette", reason="needs the extra 'console'")
pytest.importorskip("playwright", reason="needs playwright, of the extra 'test'")
pytest.importorskip("mink", reason="needs the extra 'retarget'")

_ENGAGES_S, _AT_REST_S = 3.0, 0.3
PALM = np.array([[0.08, 0.0, 0.0]])  # in the frame of the last link of a wrist
# The controllers go up and out within four seconds, and forth and back for as long as the page lives.
SWING = """
const began = performance.now(), start = {};
for (const side of ["left", "right"]) { const p = xr.controllers[side].position; start[side] = [p.x, p.y, p.z]; }
window.swing = setInterval(() => {
  const t = (performance.now() - began) / 1000, size = Math.min(t / 4, 1);
  for (const side of ["left", "right"]) {
    const [x, y, z] = start[side], out = side === "right" ? 1 : -1;
    xr.controllers[side].position.set(
      x + out * 0.06 * size * (1 + Math.sin(t)), y + 0.08 * size * (1 + Math.sin(0.7 * t)), z - 0.08 * size);
  }
}, 16);
"""


class Worn:
    """A station whose operator wears the headset of a browser."""

    def __init__(self, home: Home, browser: Any, runbook: str, *sets: str) -> None:
        self.home = home
        settings = [word for setting in ("webxr.port=0", *sets) for word in ("--set", setting)]
        self._running = home.running("up", f"runbooks/{runbook}.yaml", "--yes", "--record", "--task", "worn", *settings)
        self.station: Running = self._running.__enter__()
        self.station.wait_for("start teleop")
        self.bus = Bus(home.bus, name="test", timeout_s=5.0)
        self.url = ""
        wait_until(self._is_served)
        self._browser = browser

    def _is_served(self) -> bool:
        facts = codec.parse_facts(self.bus.get(keys.server_config("webxr")))
        self.url = str(facts.get("device", {}).get("page", ""))
        return bool(self.url)

    @property
    def link(self) -> str:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in self.home.environment.items():
                patch.setenv(name, value)
            return f"{self.url}?token={Keyring().token('operator')}"

    def page(self, **more: Any) -> HeadsetPage:
        return HeadsetPage(self._browser, self, **more)  # type: ignore[arg-type]  # it needs but the link

    def gate(self, robot: str) -> str:
        return str(codec.parse_facts(self.bus.get(keys.command_gate(robot))).get("state", ""))

    def told(self, event: str) -> int:
        """Return how often the output of the station names an event."""
        return self.station.text.count(event)

    def engage(self, press: Callable[[], object], lift: Callable[[], object]) -> None:
        """Press again and again until the operator is engaged: the page of a busy machine may miss a press."""
        begun = self.told("operator-engaged")
        for _ in range(20):
            press()
            with contextlib.suppress(AssertionError):
                wait_until(lambda: self.told("operator-engaged") > begun, _ENGAGES_S)
                return
            lift()
            time.sleep(_AT_REST_S)  # an operator's pause between two presses
        raise AssertionError(f"never engaged:\n{self.station.text}")

    def source(self, key: str) -> dict[str, Any]:
        return codec.parse_facts(self.bus.get(key))

    def end(self) -> str:
        """End the station; return what it recorded."""
        self.bus.close()
        self.station.interrupt()
        code, out = self.station.finish()
        assert code == 0, self.station.text
        return out.strip()

    def close(self) -> None:
        self.bus.close()
        self._running.__exit__(None, None, None)


def palms_of(joints: Floats) -> Floats:
    """Return where the palms are in the frame of the pelvis, shape (2, 3) [m]."""
    poses = kinematics.forward(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), joints[np.newaxis])
    return np.array([poses.points(f"{side}_wrist_yaw", PALM)[0, 0] for side in ("left", "right")])


def hands_and_palms(worn: Worn) -> tuple[Floats, Floats]:
    """Return where the operator's hands are, in their world, and the robot's palms, by its measured joints [m]."""
    hands = [
        codec.parse_f64(worn.bus.get(key("webxr")) or b"")[:3] for key in (keys.operator_left, keys.operator_right)
    ]
    state = codec.parse_f64(worn.bus.get(keys.sim_qpos(ROBOT)) or b"")
    return np.array(hands), palms_of(state[7 : 7 + len(G1_29)])


def drive(worn: Worn, seconds: float) -> Floats:
    """Have the hands swing for a time; return how far the palms were from where they were led to, shape (n, 2) [m]."""
    page = worn.page().enter()
    try:
        wait_until(lambda: b'"live"' in (worn.bus.get(keys.operator_status("webxr")) or b""))
        hands, palms = hands_and_palms(worn)
        worn.engage(lambda: page.squeeze("a-button"), lambda: page.squeeze("a-button", value=0.0))
        page.squeeze("a-button", value=0.0)
        worn.station.wait_until(lambda: worn.gate(ROBOT) == "tracking")
        hands, palms = hands_and_palms(worn)
        for _ in range(30):  # on a busy machine the arms are still on their way there
            page.tab.wait_for_timeout(100)
            (hands, palms), before = hands_and_palms(worn), palms
            if np.abs(palms - before).max() < 0.002:
                break
        page.do(SWING)
        wrong, until_s = [], time.monotonic() + seconds
        while time.monotonic() < until_s:
            page.tab.wait_for_timeout(100)
            now_hands, now_palms = hands_and_palms(worn)
            wrong.append(np.linalg.norm((now_palms - palms) - (now_hands - hands), axis=-1))
        moved = np.linalg.norm(now_hands - hands, axis=-1)
        assert (moved > 0.08).all(), moved
        assert page.trouble == []
        return np.array(wrong)
    finally:
        page.close()
