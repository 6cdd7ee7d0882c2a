"""`KordBridge`: one arm, one session, one real-time thread in C++ that this class only hands targets to.

The thread calls, once per tick and in this order, waitSync, the command, fetchData. It never waits for Python: targets
and states are handed over through buffers that neither side can hold, so a Python that stops, for a garbage collection
or for ever, is an arm that stays where its last target was.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station_kord import _native
from station_kord.conversions import native_options, native_profile, state_of
from station_kord.errors import BadOption
from station_kord.options import Limits, SimOptions, seven
from station_kord.profiles import Profile
from station_kord.simulator import Simulator
from station_kord.state import TRACE, Floats, State

BACKEND: str = _native.BACKEND
"""What this build talks to: ``sim``, the simulated controller, or ``kord``, a real one through kord-api."""


class KordBridge:
    """One arm.

    Life: `connect` → `engage` → commands → `hold` … → `close`. After a fault: `clear_faults` → `engage` → commands.
    Commands go to the next tick; the newest wins. All methods may be called from any thread; none but `connect`,
    `close`, `clear_faults` and `step` waits for anything.

    Args:
        host: Address of the controller; ``unix:PATH`` for a simulated controller in a process of its own
            (`ControllerServer`); with `sim` any name, which is only told.
        port: UDP port; not used by the simulator.
        session_id: Of the KORD session.
        limits: What the arm may be asked for.
        profile: How streams are tracked: a name in `PROFILES`, or a profile of one's own.
        sim: Simulate the controller within this process; None for a real one or for ``unix:PATH``.
        real_time_priority: SCHED_FIFO priority asked for, 1 to 99; 0 asks for none. Not granted: told in `real_time`.
        lock_memory: Whether to ask for the whole process's memory to be locked, while connected. Not granted: told.
        trace_ticks: How many ticks `trace` remembers; 0 for none.

    Raises:
        BadOption: An option is out of its range; or the simulator is asked of a build for real controllers, or a real
            controller of a build with the simulator.
    """

    def __init__(
        self, host: str = "sim", port: int = 7582, session_id: int = 1, *, limits: Limits,
        profile: str | Profile = "speed125", sim: SimOptions | None = None, real_time_priority: int = 70,
        lock_memory: bool = False, trace_ticks: int = 5000,
    ) -> None:  # fmt: skip
        self._check_backend(host, sim)
        if not 0 <= real_time_priority <= 99:
            raise BadOption(f"real_time_priority: 0 to 99 is expected, not {real_time_priority}")
        options = sim or SimOptions()
        config = _native.BridgeConfig()
        config.host, config.port, config.session_id = host, port, session_id
        config.q_min, config.q_max = list(limits.q_min), list(limits.q_max)
        config.qd_max, config.qdd_max = list(limits.qd_max), list(limits.qdd_max)
        config.profile = native_profile(profile)
        config.is_simulated = sim is not None or host.startswith("unix:")
        config.fetch_first = options.order == "fetch-first"
        config.resend_targets = options.resend_targets
        config.real_time_priority, config.lock_memory = real_time_priority, lock_memory
        config.trace_ticks = trace_ticks
        self._simulator = Simulator(_native.Simulator(native_options(sim))) if sim is not None else None
        self._bridge = _native.Bridge(config, self._simulator.native if self._simulator else None)

    @staticmethod
    def _check_backend(host: str, sim: SimOptions | None) -> None:
        if BACKEND != "sim" and (sim is not None or host.startswith("unix:")):
            raise BadOption(
                "this build of station_kord is for real controllers; the simulator is in a build without kord-api"
            )
        if BACKEND == "sim" and sim is None and not host.startswith("unix:"):
            raise BadOption(
                f"host {host!r}: this build of station_kord has the simulator only; build it where kord-api is"
                " installed, with -C cmake.define.STATION_KORD_BACKEND=kord"
            )

    @property
    def simulator(self) -> Simulator | None:
        """The simulated controller within this process, or None."""
        return self._simulator

    @property
    def real_time(self) -> str:
        """What the system permitted, for people: ``SCHED_FIFO 70, memory not locked``; empty before `connect`."""
        return self._bridge.real_time()

    def connect(self, timeout_s: float = 5.0) -> State:
        """Open the session and start the loop; return the first state.

        The arm is not engaged afterwards. Connecting again after a lost session keeps all counters.

        Raises:
            NotConnected: No controller answered in time; the message says what to look at.
        """
        self._bridge.connect(timeout_s)
        return self.get_state()

    def close(self) -> None:
        """Let the arm come to rest, end the session and the thread; closing twice is as good as once.

        Velocities are brought to zero as if their commands had ceased; what the controller has of a stream is finished.
        """
        self._bridge.close()

    def __enter__(self) -> KordBridge:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def get_state(self) -> State:
        """Return a snapshot of the newest finished tick; never waits for the loop.

        Before the first tick all is zero and `is_connected` False.
        """
        return state_of(self._bridge.state())

    def engage(self) -> Floats:
        """Take commands from now on, as a dead-man's press asks for; return the joints that they start from [rad].

        All older targets are forgotten; the running target is the joints as they are now.

        Returns:
            Shape (7,) [rad].

        Raises:
            NotConnected: There is no session.
            Refused: The arm is faulted (`clear_faults` first) or still moves, or the controller is not ready. Where it
                begins to move, or is being cleared, in the very tick, the next command is refused as not engaged.
        """
        return np.array(self._bridge.engage())

    def hold(self) -> None:
        """Come to rest and stay there; stays engaged.

        Of a stream the arm finishes what it has, if that takes no longer than 0.15 s; a velocity ramps down within
        100 ms; a far target of a stream, and a move of `move_j` or `move_l`, are replaced by one that ends within
        100 ms, or as soon as `Limits.qdd_max` allows. What is asked for after it does not undo it. A stop by which the
        arm still moves 80 ms after its time is sent again, three times for each `hold`. Of a profile of stop-points the
        arm finishes all that it has. Whether a real controller lets a running move be replaced is not known: what stops
        it for certain is its own stop. One that finishes the move first goes back in 100 ms then, or faults (3002).
        """
        self._bridge.hold()

    def disengage(self) -> None:
        """Hold, and refuse commands until `engage`."""
        self._bridge.disengage()

    def stream_j(self, q: Sequence[float] | Floats) -> None:
        """Hand over the newest target of a stream of joint positions.

        Sent on the profile's turns only, and once: a target that stays is not sent again. The newest target that was
        handed over is always sent in the end, again where it could not leave this machine.

        Args:
            q: Shape (7,) [rad].

        Raises:
            OutOfLimits: A joint is beyond `Limits.q_min`, `q_max`.
            Refused: Not engaged, faulted, or the arm still moves in another mode.
            NotConnected: There is no session.
        """
        self._bridge.stream_j(seven("stream_j", q))

    def velocity_j(self, qd: Sequence[float] | Floats) -> None:
        """Move the joints at these speeds, for as long as this is called again and again.

        Integrated in C++ at 250 Hz into direct joint commands, with accelerations within `Limits.qdd_max`, 11 rad/s² up
        and 25 rad/s² down. 20 ms after the last call the speed begins to fall, after 100 ms the arm stands; a tick
        later where a command is missed in a fast fall. At a position limit a joint stops. Where more than one command
        was missed and the next would be a jump, it begins anew once the arm stands.

        Args:
            qd: Shape (7,) [rad/s].

        Raises:
            OutOfLimits: A speed is beyond `Limits.qd_max`, or above 2.66 rad/s, from which the arm could not stand
                within 100 ms without a torque deviation (1010).
            Refused, NotConnected: As for `stream_j`.
        """
        self._bridge.velocity_j(seven("velocity_j", qd))

    def direct_j(
        self, q: Sequence[float] | Floats, qd: Sequence[float] | Floats | None = None,
        qdd: Sequence[float] | Floats | None = None,
    ) -> None:  # fmt: skip
        """Hand over one direct joint command, sent in the next tick as it is.

        The first one after another mode must be the arm's joints. One that is further from the last, or changes its
        speed by more, than `Limits` allow in the time between is not sent (`State.limit_refusals`). Without a next one
        in 20 ms the last speed falls to zero within 100 ms. Where more than one was missed and the next would be a
        jump, the motion ends. The controller faults (1010) where a command is not where the one before led; those that
        `velocity_j` makes always are.

        Args:
            q, qd, qdd: Shape (7,) [rad], [rad/s], [rad/s²]; None for zeros.

        Raises:
            OutOfLimits: A position, speed or acceleration is beyond its limit, or a speed above 2.66 rad/s: see
                `velocity_j`.
            Refused, NotConnected: As for `stream_j`.
        """
        zeros = (0.0,) * 7
        self._bridge.direct_j(
            seven("direct_j q", q), seven("direct_j qd", zeros if qd is None else qd),
            seven("direct_j qdd", zeros if qdd is None else qdd),
        )  # fmt: skip

    def move_j(self, q: Sequence[float] | Floats, *, speed_radps: float = 0.3) -> None:
        """Move to joint positions once and stop there; `hold` and `disengage` end it before.

        It, as `move_l`, is under way until the arm stands there, to 1 mrad (and 1 mm), or it is held.

        Args:
            q: Shape (7,) [rad].
            speed_radps: Mean speed of the joint with the furthest to go [rad/s].

        Raises:
            OutOfLimits: A joint, or the speed, is beyond its limit.
            Refused, NotConnected: As for `stream_j`.
        """
        self._bridge.move_j(seven("move_j", q), speed_radps)

    def move_l(self, pose: Sequence[float] | Floats, *, speed_mps: float = 0.1) -> None:
        """Move the tool along a straight line once and stop there; `hold` and `disengage` end it before.

        Args:
            pose: Position [m] and roll, pitch, yaw [rad] in the base frame, shape (6,).
            speed_mps: Mean speed of the tool [m/s], 2 at most.

        Raises:
            BadOption: Not six finite numbers.
            OutOfLimits: The speed is not above 0, or beyond its limit.
            Refused, NotConnected: As for `stream_j`.
        """
        numbers = [float(value) for value in pose]
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise BadOption(f"move_l: six finite numbers are needed, x y z roll pitch yaw; these are {numbers}")
        self._bridge.move_l(numbers, speed_mps)

    def set_profile(self, profile: str | Profile) -> None:
        """Track streams by another profile from the next tick on in which the arm stands; its throttle holds with it.

        Raises:
            Refused: The arm moves, or the profile is for the simulator only and the controller is real.
            BadOption: No profile of that name, or a value that is out of its range or not finite.
        """
        self._bridge.set_profile(native_profile(profile))

    def set_throttle(self, ticks: int) -> None:
        """Send the stream's target on every so-manieth tick from the next tick on, also in motion.

        Raises:
            BadOption: Not 1 to 250.
        """
        self._bridge.set_throttle(ticks)

    def clear_faults(self, deadline_s: float = 5.0) -> State:
        """Clear what the controller is stopped by; return the state afterwards, which is not engaged.

        A session that was lost is opened anew. Nothing is sent where there is no alarm. Old targets are forgotten. With
        a virtual clock this steps the time itself.

        Raises:
            Refused: Only a person at the controller can clear it, or it was not cleared in time.
            NotConnected: The controller does not answer.
        """
        self._bridge.clear_faults(deadline_s)
        return self.get_state()

    def trace(self, ticks: int | None = None) -> NDArray[Any]:
        """Return the last ticks, oldest first, as rows of `TRACE`; all that are remembered by default.

        Returns:
            Shape (n,), n at most `trace_ticks`.
        """
        return np.frombuffer(self._bridge.trace(-1 if ticks is None else ticks), dtype=TRACE)

    def step(self, ticks: int = 1) -> State:
        """Let so many ticks of a virtual clock pass, and the loop finish each of them; return the state afterwards.

        Raises:
            Refused: The clock is no virtual one.
            NotConnected: There is no session; one that is lost while stepping ends the step.
        """
        self._bridge.step(ticks)
        return self.get_state()
