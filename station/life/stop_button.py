"""The emergency stop as a person presses it: a line of its own to the bus, and the truth about whether it was taken.

It also reaches the robots of this machine's stations where the bus is dead (`station.life.stop_line`).

Whether the bus takes it or not, a press is kept in the stop's file (`station.life.stop_file`) until it is released.

The command line, the keys of ``station up`` and the buttons of input devices all press this one. It needs nobody else:
no supervisor, no recorder, no command server.
"""

from __future__ import annotations

import getpass
from collections.abc import Callable
from types import TracebackType

import msgspec

from station.bus import acl, codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import BusError, NotReady, StoppedPastBus
from station.life import arm_request
from station.life.server import Health, read_health
from station.life.stop_file import StopFile, StopKeeper
from station.life.stop_line import StopCall, StopReply

WITHIN_S = 1.0
"""How long a press tries before it says that it was not taken [s]."""

_ANSWER_S = 0.25  # of one try; a server that answers takes under a millisecond
_AGAIN_S = 0.02
_LOOK_S = 0.005


def say_past_bus(address: BusAddress, reason: str) -> StopCall:
    """Stop the robots of this user's stations on this machine past the bus, at once; as `StopButton.press` does too."""
    return StopCall(address, f"{getpass.getuser()}, {reason}")


def keep_for_the_next_start(address: BusAddress, reason: str, error: BusError, call: StopCall) -> BusError:
    """Keep a stop in its file where no bus took it, so that nothing starts under it; return what to raise.

    Args:
        address: The bus that is not there.
        reason: Why to stop.
        error: Why the bus could not be reached.
        call: What was said past the bus.
    """
    StopFile(address).latch(f"{getpass.getuser()}, {reason}")
    said = call.reply()
    if said.told:
        return _past_bus(error, said)
    return BusError(f"NO robot was stopped ({error}){_not_told(said)}; the stop is latched for the next start")


def _past_bus(error: BusError, said: StopReply) -> StoppedPastBus:
    return StoppedPastBus(
        f"stopped past the bus: {', '.join(said.told)}{_not_told(said)}; the bus did not take the stop ({error}), so "
        "see that every robot is damped; it is latched for the next start",
        said.told,
    )


def _not_told(said: StopReply) -> str:
    return f"; NOT told: {', '.join(said.not_told)} (on another machine, or dead)" if said.not_told else ""


class StopButton:
    """A button; safe to press from any thread, as often as one likes. Its `close` waits for the stop's file.

    Args:
        address: The bus that the robots listen on.
        name: Who presses, in the stamps.
        who: Who presses, for the recording; "" for this user's login name.

    Raises:
        BusError: the bus cannot be reached: a button that does nothing must be known before it is needed.
    """

    def __init__(self, address: BusAddress, *, name: str = "estop", who: str = "") -> None:
        self._bus = Bus(address, name=name, timeout_s=_ANSWER_S)
        self._address, self._clock = address, self._bus.clock
        self._who = who or getpass.getuser()
        self._lock = self._clock.lock()
        self._user = address.username or "default"
        self._press_key = acl.stop_key(address.username)
        self._keeper = StopKeeper(address)

    def press(self, reason: str) -> None:
        """Stop every robot on the bus, latched: their joints are damped until somebody releases the stop.

        It goes to the stations of this machine past the bus first, which takes no time.

        Raises:
            StoppedPastBus: the bus did not take it, but such a station did.
            BusError: the bus did not take it, however often it was tried within `WITHIN_S`, and nobody else.
        """
        asked_ns, said = self._clock.monotonic_ns(), f"{self._who}, {reason}"
        call = StopCall(self._address, said)
        try:
            self._write(self._press_key, {"stop": True, "who": self._who, "reason": reason})
        except BusError as error:
            if (reply := call.reply()).told:
                raise _past_bus(error, reply) from None
            raise BusError(f"the stop was NOT taken ({error}); use the robot's own stop") from None
        finally:
            call.close()
            self._keeper.latch(said, asked_ns)

    def release(self, reason: str, *, arm: bool = False) -> None:
        """Leave the stop; with `arm` a real robot is armed too.

        Raises:
            BusError: the bus did not take it.
        """
        asked_ns = self._clock.monotonic_ns()
        try:
            request = {"stop": False, "who": self._who, "reason": reason} | ({"arm": True} if arm else {})
            self._write(keys.ESTOP, request, removed=keys.ESTOP_PRESSED)
        except BusError as error:
            who = f"; expected the bus's operator or console, not {self._user!r}" if "NOPERM" in str(error) else ""
            raise BusError(f"the stop is still latched ({error}){who}") from None
        self._keeper.release(f"{self._who}, {reason}", asked_ns)

    def unstopped(self, within_s: float = WITHIN_S) -> dict[str, str]:
        """Wait until every robot on the bus is stopped; return the gate of those that are not in time, by server.

        Raises:
            BusError: the bus was lost meanwhile.
        """
        return self._wait(lambda gate: gate != "stopped", within_s)

    def unreleased(self, within_s: float = WITHIN_S) -> list[str]:
        """Wait until no robot on the bus is stopped; return the servers of those that still are.

        Raises:
            BusError: the bus was lost meanwhile.
        """
        return list(self._wait(lambda gate: gate == "stopped", within_s))

    def _wait(self, is_left: Callable[[str], bool], within_s: float) -> dict[str, str]:
        deadline_s = self._clock.monotonic_s() + within_s
        while True:
            left = {name: gate for name, gate in self._gates().items() if is_left(gate)}
            if not left or self._clock.monotonic_s() >= deadline_s:
                return left
            self._clock.sleep(_LOOK_S)

    def robots(self) -> list[str]:
        """Return the names of the servers that drive a robot now.

        Raises:
            BusError: the bus is lost.
        """
        return [health.name for health in self._active()]

    def close(self) -> None:
        """Hang up, once the newest word is in the stop's file."""
        self._bus.close()
        self._keeper.close()

    @property
    def not_kept(self) -> str:
        """Why the newest word could not be kept in the stop's file, or ""; known once it is closed."""
        return self._keeper.failure

    def __enter__(self) -> StopButton:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, key: str, request: dict[str, object], *, removed: str = "") -> None:
        value, deadline_s = codec.json_object(request), self._clock.monotonic_s() + WITHIN_S
        while True:
            try:
                with self._lock:
                    self._write_once(key, value, removed)
            except BusError as error:
                if key == keys.ESTOP_PRESSED and "NOPERM" in str(error):
                    key = keys.ESTOP  # by a list that was made before there was a key of its own for a press
                    continue
                if self._clock.monotonic_s() > deadline_s:
                    raise
                self._clock.sleep(_AGAIN_S)
            else:
                return

    def _write_once(self, key: str, value: bytes, removed: str) -> None:
        """Write it and wait for the server's word: a write that is only on its way stops no robot."""
        if removed and self._bus.get(removed) is not None:
            self._bus.call("DEL", removed)
        lost = self._bus.lost_writes
        if not self._bus.publish({key: value}):
            raise BusError(self._bus.last_error or f"bus {self._bus.address}: no answer")
        self._bus.call("PING")  # answered after the write, on the same line
        if self._bus.lost_writes > lost:
            raise BusError(self._bus.last_error)

    def _active(self) -> list[Health]:
        """Return the servers that drive a robot; one that loads will find the stop when it begins."""
        found, now_ns = read_health(self._bus), self._clock.wall_ns()
        driving = [health for health in found if (health.role, health.state) == ("low-level", "active")]
        return [health for health in driving if health.is_alive_at(now_ns)]

    def _gates(self) -> dict[str, str]:
        found = {}
        for health in self._active():
            try:
                found[health.name] = _gate(
                    self._bus.get(keys.command_gate(arm_request.robot_of(self._bus, health.name)))
                )
            except NotReady as error:
                found[health.name] = str(error)
        return found


class _Gate(msgspec.Struct):
    state: str = "silent"


def _gate(data: bytes | None) -> str:
    try:
        return codec.parse_struct(data or b"{}", _Gate).state
    except codec.BadValue:
        return "unreadable"
