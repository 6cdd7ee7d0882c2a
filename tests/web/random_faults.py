"""Faults of console, page, link and bus in random orders, and what a page says after each."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from typing import Any

from tests.waiting import wait_until
from tests.web.browser import Page
from tests.web.console_process import ConsoleProcess
from tests.web.standing import Standing

UNHEARD = {"no-link", "not-taken", "stopping"}
"""Kinds of words of a page that hears nothing of a station, or of a station without a bus."""


class Faults:
    """A page of a console of its own, on the bus of a robot that stands.

    Args:
        g1: The robot; its bus may be frozen.
        browser: Opens the page.
        seed: Of the order.

    Attributes:
        presses: Stops that were pressed.
        log: What was done.
    """

    def __init__(self, g1: Standing, browser: Any, seed: int) -> None:
        self._g1, self._browser, self._random = g1, browser, random.Random(seed)
        self._console: ConsoleProcess = g1.new_console("--name", f"faulty-{seed}")
        self._port, self._number, self._seed = self._console.port, 0, seed
        self._link = self._console.links()["operator"]
        self.page = Page(browser, self._link).ready()
        self.is_console_frozen = self.is_bus_frozen = self.is_offline = False
        self._is_stopped = False
        self.presses = 0
        self.log: list[str] = []

    def act(self) -> str:
        """Do one thing; return its name."""
        acts: dict[str, Callable[[], None]] = {
            "press": self._press, "reload": self._reload, "kill console": self._kill_console,
            "freeze console": self._freeze_console, "freeze bus": self._freeze_bus, "cut line": self._cut,
            "heal": self.heal, "release": self._release,
        }  # fmt: skip
        name = self._random.choice(list(acts))
        self.log.append(name)
        acts[name]()
        return name

    def right_words(self) -> set[str]:
        """Return the kinds of words that are true now."""
        if not self.is_bus_frozen:
            self._is_stopped = self._g1.gate() == "stopped"
        is_heard = not (self.is_console_frozen or self.is_offline or self.is_bus_frozen)
        if is_heard:
            return {"stopped"} if self._is_stopped else {"ready"}
        return UNHEARD | ({"stopped"} if self._is_stopped else set())  # a robot that said so is so until a release

    def wait_for_right_words(self, timeout_s: float = 30.0) -> float:
        """Wait until the page says what is true; return how long that took [s]."""
        began_s = time.monotonic()
        try:
            wait_until(lambda: self.page.stop_kind in self.right_words(), timeout_s)
        except AssertionError:
            told = self.page.read("({stop: stationPage.stop, link: stationPage.link})")
            raise AssertionError(f"{self.log}: page says {told}, true is {self.right_words()}") from None
        return time.monotonic() - began_s

    def heal(self) -> None:
        """Have all be well again."""
        if self.is_bus_frozen:
            os.kill(self._g1.bus_pid, signal.SIGCONT)
        if self.is_console_frozen:
            self._console.thaw()
        if self.is_offline:
            self.page.context.set_offline(False)
        self.is_console_frozen = self.is_bus_frozen = self.is_offline = False

    def close(self) -> None:
        """End it."""
        self.heal()
        self.page.close()
        self._console.kill()

    def _press(self) -> None:
        self.presses += 1
        self.page.press_stop()

    def _release(self) -> None:
        if not self.is_bus_frozen:
            self._g1.wait_again()

    def _reload(self) -> None:
        if self.is_offline or self.is_console_frozen:
            return  # a browser without a server shows its own page, which is none of ours
        if self.page.read("stationPage.stop.presses > 0 && !stationPage.stop.is_taken"):
            return  # a page that goes takes an unanswered press with it, as everybody sees
        self.page.tab.goto(self._link)
        self.page.until("window.stationPage && stationPage.is_known")

    def _kill_console(self) -> None:
        self._console.kill()
        self._number += 1
        self.is_console_frozen = False
        name = f"faulty-{self._seed}-{self._number}"
        self._console = self._g1.new_console("--name", name, port=self._port)

    def _freeze_console(self) -> None:
        self._console.freeze()
        self.is_console_frozen = True

    def _freeze_bus(self) -> None:
        os.kill(self._g1.bus_pid, signal.SIGSTOP)
        self.is_bus_frozen = True

    def _cut(self) -> None:
        self.page.context.set_offline(True)
        self.is_offline = True
