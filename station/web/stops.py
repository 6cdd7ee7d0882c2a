"""The stop of the pages: the same button as a terminal's, pressed by whichever way a page reaches us first.

A press comes by several ways and again and again until it is answered; by its id it is written once. A press never
waits for anything but the bus, and one that the bus did not take goes on being tried by the page.
"""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Literal, NamedTuple

from station.bus.address import BusAddress
from station.errors import BusError, StoppedPastBus
from station.life.stop_button import StopButton, keep_for_the_next_start, say_past_bus
from station.printable import printable

_MOST = 256  # presses that are remembered
_SIDE_BY_SIDE = 8
_LONGEST = 200


Outcome = Literal["taken", "past-bus", "not-taken"]


class Said(NamedTuple):
    """What became of a press, and that in words.

    Attributes:
        outcome: ``taken`` by the bus; ``past-bus``, where only the stations of this machine were told; or neither.
        text: Which robots, or why not.
    """

    outcome: Outcome
    text: str


class Stops:
    """Presses the stop for pages; safe to use from any thread.

    Args:
        address: The bus that the robots listen on.
        name: Who presses, in the stamps.
    """

    def __init__(self, address: BusAddress, name: str) -> None:
        self._address, self._name = address, name
        self._button: StopButton | None = None
        self._lock = threading.Lock()  # of what was pressed: never held for long, the pages' event loop takes it
        self._opening = threading.Lock()  # of the button: held while a connection is made, for a second if a bus hangs
        self._threads = ThreadPoolExecutor(_SIDE_BY_SIDE, "console-stop")
        self._pressed: OrderedDict[str, Future[Said]] = OrderedDict()

    def press(self, press: str, reason: str) -> Future[Said]:
        """Press it; one that has this id already and is under way, or was taken, is not pressed again.

        Args:
            press: Id of the press.
            reason: Why, and who.
        """
        with self._lock:
            known = self._pressed.get(press)
            if known is not None and (not known.done() or known.result().outcome == "taken"):
                return known
            found = self._threads.submit(self._press, printable(reason, _LONGEST))
            self._pressed[press] = found
            self._pressed.move_to_end(press)
            while len(self._pressed) > _MOST:
                self._pressed.popitem(last=False)
            return found

    def release(self, reason: str) -> None:
        """Release the stop.

        Raises:
            BusError: the bus did not take it.
            NotReady: a robot is still stopped.
        """
        self._opened().release(printable(reason, _LONGEST))

    def warm(self) -> None:
        """Connect before the button is needed, where there is a bus."""
        try:
            self._opened()
        except BusError:
            return

    def close(self) -> None:
        """Hang up, once what was pressed is answered."""
        self._threads.shutdown()
        if self._button is not None:
            self._button.close()

    def _opened(self) -> StopButton:
        with self._opening:
            if self._button is None:
                self._button = StopButton(self._address, name=self._name)
            return self._button

    def _press(self, reason: str) -> Said:
        button = self._button
        if button is None:
            with contextlib.closing(say_past_bus(self._address, reason)) as call:  # before the bus, which may hang
                try:
                    button = self._opened()
                except BusError as error:
                    return _failed(keep_for_the_next_start(self._address, reason, error, call))
        try:
            button.press(reason)
        except BusError as error:
            return _failed(error)
        try:
            robots = ", ".join(button.robots()) or "no robot is driven"
        except BusError:
            robots = "the bus was lost meanwhile"
        return Said("taken", robots)


def _failed(error: BusError) -> Said:
    if isinstance(error, StoppedPastBus):
        return Said("past-bus", f"{', '.join(error.told)}; {error}")
    return Said("not-taken", str(error))
