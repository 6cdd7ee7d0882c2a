"""Between values of Python and those of the compiled part."""

from __future__ import annotations

from typing import Any

import numpy as np

from station_kord import _native
from station_kord.errors import BadOption
from station_kord.options import SimOptions
from station_kord.profiles import PROFILES, Profile
from station_kord.state import Event, State, Timing

_ARRAYS = ("q", "qd", "qdd", "torque", "tcp_pose", "q_target", "q_sent")
_TIMINGS = ("sync_to_send_us", "period_us")
_PLAIN = tuple(name for name in State.__slots__ if name not in {*_ARRAYS, *_TIMINGS, "events", "backend"})


def native_profile(profile: str | Profile) -> _native.Profile:
    """Return a profile, or the one of that name, for C++.

    Raises:
        BadOption: There is none of that name.
    """
    if isinstance(profile, str):
        if profile not in PROFILES:
            raise BadOption(f"profile {profile!r} is not known; there are {', '.join(PROFILES)}")
        profile = PROFILES[profile]
    native = _native.Profile()
    native.name = profile.name
    native.tracks_time = profile.tracking == "time"
    native.tracking_value = profile.tracking_value
    native.blends = profile.blend == "time"
    native.blend_s = profile.blend_s
    native.stops_at_points = profile.overlay == "stop-point"
    native.throttle = profile.throttle
    native.offset_guard = profile.offset_guard
    native.guard_qdd_radps2 = profile.guard_qdd_radps2
    native.sim_only = profile.sim_only
    return native


def state_of(native: _native.State) -> State:
    """Return a snapshot with arrays of its own."""
    told: dict[str, Any] = {name: getattr(native, name) for name in _PLAIN}
    told |= {name: np.array(getattr(native, name)) for name in _ARRAYS}
    for name in _TIMINGS:
        timing = getattr(native, name)
        told[name] = Timing(last=timing.last, p50=timing.p50, p99=timing.p99, max=timing.max)
    told["events"] = tuple(Event(**{part: getattr(event, part) for part in Event.__slots__}) for event in native.events)
    return State(backend=_native.BACKEND, **told)


def native_options(options: SimOptions) -> _native.SimOptions:
    """Return the same for C++."""
    native = _native.SimOptions()
    native.is_virtual = options.clock == "virtual"
    for name in ("q_start", "q_min", "q_max"):
        setattr(native, name, list(getattr(options, name)))
    for name in (
        "qd_max_radps", "qdd_max_radps2", "window_us", "fetch_closes_window", "buffer_len", "planner_time_ms",
        "torque_deviation_rad", "late_fault_ticks", "ack_ticks", "watchdog_ticks", "ceased_is_fault",
        "speed_noise_radps", "noise_seed", "opaque", "queues_after_stop_point",
    ):  # fmt: skip
        setattr(native, name, getattr(options, name))
    native.planner_speed_ms = options.planner_speed_cost_ms
    return native
