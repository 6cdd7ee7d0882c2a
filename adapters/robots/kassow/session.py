"""A session with a Kassow controller, or with the simulated one: `station_kord` as a `station.arms.ArmSession`.

Its clock and its thread are the native package's (`adapters.robots.kassow.native`); here nothing waits but `clear`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from adapters.robots.arm_limits import ArmLimits
from adapters.robots.kassow import kinematics
from adapters.robots.kassow.names import ARM_7
from adapters.robots.kassow.native import kord
from station.arms import ArmState
from station.errors import ConfigError, NotReady
from station.protocols import Floats

if TYPE_CHECKING:
    from station_kord import KordBridge, Profile, SimOptions, State

Preset = Literal["final", "narrative"]

CLEAR_WITHIN_S = 5.0
"""Longest time for clearing a controller's faults [s]; a token's answer takes about 40 ms."""

_MOST_TICKS = 1 << 30  # the bridge counts in 32 bits, and says itself how many it takes
_OVER_S = 2.0  # rates are taken over so long

_CLEAR = "station kassow clear"


class KordSession:
    """Implements `station.arms.ArmSession`.

    Args:
        bridge: Connected.
        profile: Its profile.
        limits: Of the joints.
        speed_rad_s: Greatest speed of a target [rad/s].
        lead_s: How long the arm may go on when nothing more is sent [s].
    """

    def __init__(
        self, bridge: KordBridge, profile: Profile, limits: ArmLimits, *, speed_rad_s: float, lead_s: float
    ) -> None:
        self._bridge, self._profile, self._limits = bridge, profile, limits
        self._speed_rad_s, self._lead_s = speed_rad_s, lead_s
        self._kord = kord()
        self._seen: deque[tuple[float, int, int]] = deque()  # time, ticks, sends
        self._newest: State = bridge.get_state()

    @property
    def is_simulated(self) -> bool:
        """Whether the controller is the simulated one."""
        return self.backend == "sim"

    @property
    def backend(self) -> str:
        """``sim`` or ``kord``: what the native package was built for."""
        return str(self._kord.BACKEND)

    @property
    def profile(self) -> Profile:
        """How targets are tracked, by the newest state."""
        return self._profile

    @property
    def real_time(self) -> str:
        """What the system permitted the session's thread."""
        return self._bridge.real_time

    @property
    def lead_rad(self) -> float:
        """What the arm goes in `lead_s` at the profile's speed [rad]; by time it goes as fast as its targets."""
        by_speed = self._profile.tracking == "joint-speed"
        return self._lead_s * (self._profile.tracking_value if by_speed else self._speed_rad_s)

    def read(self) -> ArmState:
        """Return the newest state of the session's thread."""
        state = self._newest = self._bridge.get_state()
        if state.profile != self._profile.name:  # the bridge takes up what was chosen when the arm stands
            self._profile = self._kord.PROFILES.get(state.profile, self._profile)
        why_blocked = beyond_reach(state.q, self._limits, self.lead_rad)
        return ArmState(
            time.monotonic_ns(), state.q, state.is_moving, state.is_engaged, fault_of(state), why_blocked, state
        )

    def engage(self) -> str:
        """Accept targets from now on."""
        return self._try(self._bridge.engage)

    def send(self, q: Floats) -> str:
        """Hand over a target of the stream."""
        return self._try(self._bridge.stream_j, q)

    def release(self) -> None:
        """Accept no more targets."""
        self._bridge.disengage()

    def clear(self) -> str:
        """Clear the controller's faults, opening a lost session anew; what no alarm is, software cannot clear."""
        return self._try(self._bridge.clear_faults, CLEAR_WITHIN_S) or not_ready(self._bridge.get_state())

    def choose(self, profile: str) -> str:
        """Track by another named profile, at standstill; return why not, or ""."""
        return self._try(self._bridge.set_profile, profile)

    def throttle(self, ticks: int) -> str:
        """Send targets on every so-manieth tick; return why not, or ""."""
        if abs(ticks) > _MOST_TICKS:
            return f"throttle {ticks}: expected a small number of ticks"
        return self._try(self._bridge.set_throttle, ticks)

    def health(self) -> dict[str, Any]:
        """Return profile and rates: heartbeats and targets per second, over the last two seconds."""
        state, now_s = self._newest, time.monotonic()
        self._seen.append((now_s, state.tick, state.stream_j_sends))
        while len(self._seen) > 2 and now_s - self._seen[1][0] >= _OVER_S:
            self._seen.popleft()
        since_s, ticks, sends = self._seen[0]
        told: dict[str, Any] = {"backend": state.backend, "profile": state.profile, "throttle": state.throttle}
        if now_s > since_s:
            told["sync_hz"] = round((state.tick - ticks) / (now_s - since_s), 1)
            told["send_hz"] = round((state.stream_j_sends - sends) / (now_s - since_s), 1)
        return told

    def close(self) -> None:
        """Let the arm come to rest and end the session."""
        self._bridge.close()

    def _try(self, act: Any, *arguments: Any) -> str:
        try:
            act(*arguments)
        except self._kord.KordError as error:
            return str(error)
        return ""


def fault_of(state: State) -> str:
    """Return why a controller takes no commands, and what to do about it, in a line, or ""."""
    if state.is_connected and not state.is_faulted:
        reason = not_ready(state)
        return f"{reason}; when it is ready: {_CLEAR}" if reason else ""
    event = state.last_event
    why = f"{event.group} {event.id}: {event.text}" if event is not None else f"alarm {state.alarm_state:#x}"
    if not state.is_connected:
        why = f"the session with the controller is lost ({why})"
    first = "confirm it at the controller, then" if state.needs_user_confirmation else "when its cause is gone"
    return f"{why}; {first}: {_CLEAR}"


def not_ready(state: State) -> str:
    """Return why a controller without an alarm takes no commands all the same, or ""."""
    return f"the controller is not ready: {state.not_ready}" if state.not_ready else ""


def beyond_reach(q: Floats, limits: ArmLimits, lead_rad: float) -> str:
    """Return which joint is so far outside its range that a target inside is farther ahead than it may be, or "".

    Args:
        q: Joints, shape (n,) [rad].
        limits: Of the joints.
        lead_rad: How far ahead of the arm a target may be [rad].
    """
    beyond = np.maximum(limits.q_min - q, q - limits.q_max)
    joint = int(np.argmax(beyond))
    if not beyond[joint] > lead_rad:
        return ""
    return (
        f"{ARM_7[joint]} is {beyond[joint]:.3g} rad outside its range of {limits.q_min[joint]:.4g} to "
        f"{limits.q_max[joint]:.4g} rad; move it back at the controller"
    )


def simulated(limits: ArmLimits, *, preset: Preset = "final", q_start: Sequence[float] | None = None) -> SimOptions:
    """Return a simulated controller of an arm.

    Args:
        limits: Of its joints.
        preset: What planning costs.
        q_start: Joints at the start, shape (7,) [rad]; None for a place in the middle of the arm's work, where one is
            known, else zeros.

    Raises:
        StationError: the native package is not installed.
        ConfigError: joints outside their limits.
    """
    at_work = kinematics.REACHING_DOWN if limits.model in kinematics.MODELS else (0.0,) * len(limits.q_min)
    start = np.array(at_work if q_start is None else q_start)
    if not ((limits.q_min <= start) & (start <= limits.q_max)).all():
        raise ConfigError(f"q_start {start.tolist()} is outside the limits of {limits.model} ({limits.file})")
    options: SimOptions = kord().SimOptions(
        preset=preset,
        q_start=start.tolist(),
        q_min=limits.q_min.tolist(),
        q_max=limits.q_max.tolist(),
        qd_max_radps=float(limits.qd_max.min()),
        qdd_max_radps2=float(limits.qdd_max.min()),
    )
    return options


def open_session(
    *,
    host: str,
    port: int,
    session_id: int,
    limits: ArmLimits,
    profile: str,
    sim: SimOptions | None,
    real_time_priority: int,
    lock_memory: bool,
    connect_within_s: float,
    speed_rad_s: float,
    lead_s: float,
) -> KordSession:
    """Connect to a controller.

    Args:
        host: Of a real controller, ``unix:PATH`` of a simulated one in a process of its own, or "" with `sim`.
        port, session_id: Of a real controller's KORD.
        limits: Of the joints; checked once more in C++.
        profile: Name of the profile to begin with.
        sim: Simulates the controller in this process; None for another one.
        real_time_priority: SCHED_FIFO priority that is asked for; 0 does not ask.
        lock_memory: Whether to ask for the memory to be locked.
        connect_within_s: Longest wait for the controller [s].
        speed_rad_s, lead_s: As of `KordSession`.

    Raises:
        StationError: the native package is not installed.
        ConfigError: an option that fits no session.
        NotReady: no controller answered.
    """
    native = kord()
    if profile not in native.PROFILES:
        raise ConfigError(f"profile {profile!r} is not known; there are {', '.join(native.PROFILES)}")
    arm = native.Limits(
        **{name: np.asarray(getattr(limits, name)).tolist() for name in ("q_min", "q_max", "qd_max", "qdd_max")}
    )
    try:
        bridge = native.KordBridge(
            host, port, session_id, limits=arm, profile=profile, sim=sim, real_time_priority=real_time_priority,
            lock_memory=lock_memory,
        )  # fmt: skip
        bridge.connect(connect_within_s)
    except native.NotConnected as error:
        raise NotReady(str(error)) from None
    except native.BadOption as error:
        raise ConfigError(str(error)) from None
    return KordSession(bridge, native.PROFILES[profile], limits, speed_rad_s=speed_rad_s, lead_s=lead_s)
