"""The simulated controller: a handle to disturb it, and a process of its own for it."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station_kord import _native
from station_kord.conversions import native_options
from station_kord.errors import BadOption
from station_kord.options import SimOptions
from station_kord.state import TRACE


class Simulator:
    """What a test or a demonstration may do to a simulated controller, from any thread.

    Args:
        native: The controller.
    """

    def __init__(self, native: _native.Simulator) -> None:
        self.native = native

    def delay_commands(self, count: int = 1) -> None:
        """Let the next commands count as come too late."""
        self.native.delay_commands(count)

    def fail_sends(self, count: int = 1) -> None:
        """Let the next commands fail to leave this machine, as with a full buffer; for a bridge of this process."""
        self.native.fail_sends(count)

    def lose_commands(self, count: int = 1) -> None:
        """Let the next commands be lost on their way: their sender hears that they were sent."""
        self.native.lose_commands(count)

    def pause(self, paused: bool) -> None:
        """Pause the controller at its pendant, or let it go on: nothing is wrong, and no command is taken."""
        self.native.pause(paused)

    def emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop; while pressed, and until `confirm`, no software can clear it."""
        self.native.emergency_stop(pressed)

    def confirm(self) -> None:
        """Confirm at the controller, as a person does after an emergency stop."""
        self.native.confirm()

    def raise_event(self, condition: int) -> None:
        """Let the controller fault by a condition: 1010, 2002, 2005, 3001 suspend it, 3002 ends the connection.

        One below 1000 is a failure of the hardware, which no request clears.
        """
        self.native.raise_event(condition)

    def silence(self, silent: bool) -> None:
        """Let the heartbeats cease, as a pulled cable does, or come back."""
        self.native.silence(silent)

    @property
    def tick(self) -> int:
        """Ticks since the controller began."""
        return self.native.tick()

    @property
    def is_moving(self) -> bool:
        """Whether the reference moves."""
        return self.native.is_moving()

    def trace(self, ticks: int | None = None) -> NDArray[Any]:
        """Return the controller's own last ticks, oldest first, as rows of `TRACE` (`q_target`, `q_sent`: its goal).

        Unlike the bridge's this goes on when the bridge is gone.

        Returns:
            Shape (n,), n at most 15 000: one minute.
        """
        return np.frombuffer(self.native.trace(-1 if ticks is None else ticks), dtype=TRACE)


class ControllerServer:
    """A simulated controller that bridges of other processes connect to, as ``unix:PATH``.

    It keeps its own time, so whatever happens to a bridge, the arm comes to rest by the controller's rules. One bridge
    at a time; the next one finds the arm where it was left.

    Args:
        path: Socket to listen at; a socket that nobody listens at any more is replaced. 100 characters at most.
        options: How the controller behaves; its clock must be ``wall``. `order` and `resend_targets` are the bridge's.
        real_time_priority: SCHED_FIFO priority asked for, above the bridge's; 0 asks for none. Where it is not granted
            heartbeats are less punctual.

    Raises:
        BadOption: The path is taken or too long, or the clock is virtual.
    """

    def __init__(self, path: Path | str, options: SimOptions | None = None, *, real_time_priority: int = 75) -> None:
        options = options or SimOptions()
        if options.clock != "wall":
            raise BadOption("a controller of its own keeps the wall clock; sim.clock must be wall")
        self.path = Path(path)
        self.simulator = Simulator(_native.Simulator(native_options(options)))
        self._server = _native.Server(str(path), self.simulator.native, real_time_priority)

    @property
    def has_client(self) -> bool:
        """Whether a bridge is connected."""
        return self._server.has_client()

    def start(self) -> None:
        """Listen and tick in a thread that holds no lock of Python.

        Raises:
            BadOption: The socket cannot be made; the message says why.
        """
        self._server.start()

    def stop(self) -> None:
        """End the thread and remove the socket; stopping twice is as good as once."""
        self._server.stop()

    def __enter__(self) -> ControllerServer:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()
