"""A Kassow arm through KORD, or its simulated controller: see `KordBridge`.

    from station_kord import KordBridge, Limits, SimOptions

    with KordBridge(limits=Limits(...), sim=SimOptions()) as arm:
        arm.connect()
        q = arm.engage()
        arm.stream_j(q)

All units are SI, all vectors are in the order of the joints. `BACKEND` tells what this build talks to.
"""

from station_kord.bridge import BACKEND, KordBridge
from station_kord.errors import BadOption, KordError, NotConnected, OutOfLimits, Refused
from station_kord.options import JOINTS, TICK_S, Limits, SimOptions
from station_kord.profiles import PROFILES, Profile
from station_kord.simulator import ControllerServer, Simulator
from station_kord.state import TRACE, Event, State, Timing

__all__ = [
    "BACKEND",
    "JOINTS",
    "PROFILES",
    "TICK_S",
    "TRACE",
    "BadOption",
    "ControllerServer",
    "Event",
    "KordBridge",
    "KordError",
    "Limits",
    "NotConnected",
    "OutOfLimits",
    "Profile",
    "Refused",
    "SimOptions",
    "Simulator",
    "State",
    "Timing",
]
