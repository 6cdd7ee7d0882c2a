"""A real Unitree G1 with 29 joints, over its own network: what it sends, and what it is sent.

Nothing is sent before the first arming. From then on there is a command in every period: the policy's targets, or
damping. Where a guard owns the motors, commands go to it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds import messages, rows, topics, types
from adapters.robots.g1.dds.command_sender import CommandSender, DirectSender, GuardedSender
from adapters.robots.g1.dds.guard_limits import most_gains
from adapters.robots.g1.dds.health_monitor import JOINTS, HealthMonitor
from adapters.robots.g1.dds.network import Network
from adapters.robots.g1.dds.options import ABSENT, LOOPBACK, G1DdsOptions
from adapters.robots.g1.dds.remote import Remote
from adapters.robots.g1.dds.switcher import Switcher
from adapters.robots.g1.joints import G1_29
from adapters.robots.legged.unitree import G1
from station.bus import codec
from station.clock import SYSTEM, Clock
from station.errors import NotReady, StationError
from station.protocols import FALL_TILT_RAD, Fall, Floats, JointTargets, RobotState
from station.rotations import tilt

FIRST_STEPS = 10
"""Commands after arming that ask for the measured pose, without stiffness."""

ENTRY_S = 2.5
"""How long targets are blended from the measured pose after arming [s]."""

COMMANDED_S = 1.0
"""After so long of commands a motor that says it gets none is ill [s]."""

GENTLE_S, GENTLE_RAD_S, _ARRIVED_RAD = 5.0, 0.9, 0.01
"""For how long after arming, at most, no target moves faster than that: below 0.02 rad in a control period. It is over
once the robot was sent where it is asked to be: a policy that balances falls where its targets come late."""

_MOST = np.concatenate([np.full(JOINTS, np.finfo(float).max), *np.array([most_gains(name) for name in G1_29]).T])
_LEAST = np.concatenate([-_MOST[:JOINTS], np.zeros(2 * JOINTS)])
_ASKED = ("position", "stiffness", "damping")  # of each joint, in this order

_DEPTH = 512  # a second of states


class G1Dds:
    """Implements `station.protocols.Robot` and `SelfChecking`. Not thread safe.

    Args:
        options: Where the robot is, and what is expected of it.
        control_dt_s: Control period [s].
        clock: Of the process.

    Raises:
        ConfigError: there is no such network interface.
        NotReady: the robot sent no state.
    """

    joint_names = G1_29

    def __init__(self, options: G1DdsOptions, control_dt_s: float, clock: Clock = SYSTEM) -> None:
        self._options, self._dt_s, self._clock = options, control_dt_s, clock
        where = f"{options.interface}, domain {options.domain}"
        self._monitor, self._remote = HealthMonitor(where, options.least_state_rate_hz), Remote()
        self._lower = np.array([joint.lower for joint in G1.joints])
        self._upper = np.array([joint.upper for joint in G1.joints])
        self._network = Network(options)
        self._states = self._network.reader(topics.LOW_STATE, types.LowState, _DEPTH)
        self._batteries = self._network.reader(topics.BATTERY, types.BmsState, depth=8)
        self._switcher = Switcher(self._network, clock)
        self._state: RobotState | None = None
        self._newest: NDArray[Any] | None = None
        self._samples: list[bytes] = []
        self._battery = b""
        self._steps = -1  # since it was armed; -1 while it is damped
        self._is_gentle = True
        self._entry_q: Floats = np.zeros(JOINTS)
        self._sent_q: Floats = np.zeros(JOINTS)
        self._is_there, self._is_short_of_motors = np.ones(JOINTS, bool), False
        self._bad_targets = ""
        try:
            self._sender: CommandSender = (
                GuardedSender(options.guard, options.guard_port, clock)
                if options.guard
                else DirectSender(self._network, control_dt_s, clock)
            )
            self._await_first_state(where)
        except StationError:
            self._network.close()
            raise

    def read(self) -> RobotState:
        """Return the newest measurement; what came before it since the last call goes to `values`."""
        self._take()
        self._switcher.poll()
        self._sender.poll()
        assert self._state is not None
        return self._state

    def _take(self) -> None:
        now_s = self._clock.monotonic_s()
        came = self._states.take()
        sent = messages.intact_states(came)
        records = self._of_motors_that_are_there(sent)
        self._monitor.on_states(records, len(came) - len(records), now_s)
        if len(records):
            self._newest = records[-1]
            self._remote.update(np.ascontiguousarray(records["remote"]))
            samples = rows.of(sent)
            self._samples.append(samples.tobytes())
            self._state = self._measured(samples[-1])
        for message in self._batteries.take():
            if (battery := messages.battery(message)) is not None:
                self._monitor.on_battery(battery[0], now_s)
                self._battery = codec.f64(battery)

    def _measured(self, sample: Floats) -> RobotState:
        """Return what a row of `rows.SAMPLES` says, with zeros for the motors that the robot does not have."""
        inertial = sample[rows.INERTIAL]
        quat = inertial[:4]
        return RobotState(
            mono_ns=self._clock.monotonic_ns(), q=self._of_motors(sample[rows.Q]), dq=self._of_motors(sample[rows.DQ]),
            quat_wxyz=quat / max(math.hypot(*quat.tolist()), 1e-9), gyro=inertial[4:7],
        )  # fmt: skip

    def _of_motors(self, values: Floats) -> Floats:
        """Return numbers of each joint, with zeros for the motors that the robot does not have."""
        return np.where(self._is_there, values, 0.0) if self._is_short_of_motors else values

    def _of_motors_that_are_there(self, records: NDArray[Any]) -> NDArray[Any]:
        """Return the states with zeros for the motors that the robot does not have, whatever it sends for them."""
        missing = ABSENT.get(int(records["mode_machine"][-1])) if len(records) else None
        if missing is None:
            return records
        absent = list(missing)
        self._is_there[:] = True
        self._is_there[absent] = False
        self._is_short_of_motors = True
        told = records.copy()
        told["motors"][:, absent] = 0
        return told

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets, and return what was sent: within the joints' ranges, and gently after arming."""
        if self._bad_targets or (why_not := _why_not_send(targets)):
            self._bad_targets = self._bad_targets or why_not
            self._send_damping()
            return self._limp()
        if not self._sender.open():  # a handshake takes a period or two
            return self._limp()
        if self._steps < 0:
            self._steps, self._entry_q, self._is_gentle = 0, self._measured_q(), True
            self._sent_q = self._entry_q
        if self._steps < FIRST_STEPS:
            q, kp = self._measured_q(), np.zeros(JOINTS)
            self._entry_q = q
        else:
            q, kp = self._gentle(targets.q), targets.kp
        q = self._of_motors(np.minimum(np.maximum(q, self._lower), self._upper))
        kp, kd = self._of_motors(kp), self._of_motors(targets.kd)
        self._steps += 1
        self._sent_q = q
        assert self._newest is not None
        self._sender.send(self._newest, q, kp, kd)
        return JointTargets(q, kp, kd)

    def damp(self) -> None:
        """Send damping alone; a robot that was never armed is sent nothing."""
        self._bad_targets = ""  # it is disarmed: that was told
        self._send_damping()

    def _send_damping(self) -> None:
        self._steps = -1
        assert self._newest is not None
        self._sender.damp(self._newest, self._measured_q())

    def _limp(self) -> JointTargets:
        zeros: Floats = np.zeros(JOINTS)
        return JointTargets(self._measured_q(), zeros, zeros)

    def fallen(self) -> Fall | None:
        """Return that it leans too far; what touches the ground it does not know."""
        assert self._state is not None
        lean = float(tilt(self._state.quat_wxyz))
        return Fall(lean, ()) if lean > FALL_TILT_RAD else None

    def why_not_arm(self) -> str:
        """Return why it must not be armed, or ""."""
        now_s = self._clock.monotonic_s()
        assert self._newest is not None
        if why_not := self.why_not_drive():
            return why_not
        if self._switcher.controller is None or now_s - self._switcher.answered_s > 2.0:
            return "the motion switcher does not answer, so who has the motors is not known"
        machine = int(self._newest["mode_machine"])
        if machine != self._options.mode_machine:
            known = {5: "29 joints", 6: "29 joints, locked waist", 4: "23 joints", 2: "29 joints, old gears"}
            return (
                f"the robot says that it is of mode_machine {machine} ({known.get(machine, 'unknown')}); expected "
                f"{self._options.mode_machine}; set mode_machine once the policy is known to be for that robot"
            )
        return self._sender.why_not_arm() or self._monitor.why_not_arm(now_s)

    def why_not_drive(self) -> str:
        """Return why its joints have to be damped now, or ""."""
        now_s = self._clock.monotonic_s()
        if stop := self._remote.stop:
            return f"{stop} on the remote"
        if self._switcher.controller:
            return f"the robot's own controller {self._switcher.controller!r} has the motors; release it first"
        if self._bad_targets:
            return self._bad_targets
        return self._sender.why_not_drive() or self._monitor.why_not_drive(now_s)

    def why_stand(self) -> str:
        """Return why it has to stop what it does and stand, to be damped a moment later, or ""."""
        return self._monitor.why_stand(is_commanded=self._steps * self._dt_s > COMMANDED_S)

    def pop_actions(self) -> list[str]:
        """Return what was asked for on the remote since the last call, as its buttons are set to ask for it."""
        asked = self._options.remote
        return [asked[button] for button in self._remote.pop_pressed() if button in asked]

    def release(self) -> None:
        """Have the robot's own controller let go of the motors: limp at once. `releasing` says when that is over."""
        self._switcher.release()

    def releasing(self) -> tuple[bool, str]:
        """Return whether a release is under way, and why the last one came to nothing, or ""."""
        return self._switcher.is_releasing, self._switcher.refused

    def values(self) -> Mapping[str, bytes]:
        """Return what was measured since the last call, by the name of its stream."""
        found = {"samples": b"".join(self._samples)} if self._samples else {}
        self._samples = []
        if self._battery:
            found["battery"], self._battery = self._battery, b""
        return found | self._sender.values()

    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""
        return {
            "states_damaged": self._monitor.damaged,
            "state_ms_lost": self._monitor.lost_ticks,
            "own_controller": self._switcher.controller,
            "why_not_arm": self.why_not_arm(),
            "guard": self._sender.guard,
            "guard_is_beside_us": self._sender.guard_is_here and self._options.interface != LOOPBACK,
        }

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this robot."""
        assert self._newest is not None
        return {
            "backend": "dds",
            "interface": self._options.interface,
            "domain": self._options.domain,
            "mode_machine": int(self._newest["mode_machine"]),
            "firmware": self._newest["version"].tolist(),
            "guard": self._sender.guard,
        }

    def close(self) -> None:
        """Leave it damped."""
        assert self._newest is not None
        self._sender.close(self._newest, self._measured_q())
        self._network.close()

    def _await_first_state(self, where: str) -> None:
        until_s = self._clock.monotonic_s() + self._options.first_state_within_s
        while self._state is None:
            self._take()
            self._clock.sleep(self._dt_s)
            if self._state is None and self._clock.monotonic_s() > until_s:
                raise NotReady(
                    f"no state of a G1 within {self._options.first_state_within_s:g} s on {where}: is it switched on, "
                    "is its cable in this interface, does this machine have an address in 192.168.123.0/24? "
                    f"({self._monitor.damaged} damaged ones came)"
                )

    def _measured_q(self) -> Floats:
        """Return where the joints are; of one that reports no number, where it was last asked to be."""
        assert self._state is not None
        return np.where(np.isfinite(self._state.q), self._state.q, self._sent_q)

    def _gentle(self, q: Floats) -> Floats:
        """Return targets that leave the pose in which the robot was armed slowly."""
        if not self._is_gentle:
            return q
        since_s = (self._steps - FIRST_STEPS) * self._dt_s
        has_arrived = since_s > ENTRY_S and float(np.abs(q - self._sent_q).max()) < _ARRIVED_RAD
        self._is_gentle = since_s < GENTLE_S and not has_arrived
        if not self._is_gentle:
            return q
        share = min(1.0, since_s / ENTRY_S)
        share = share * share * (3.0 - 2.0 * share)
        most = GENTLE_RAD_S * self._dt_s
        return self._sent_q + np.clip(self._entry_q + share * (q - self._entry_q) - self._sent_q, -most, most)


def _why_not_send(targets: JointTargets) -> str:
    """Return what no policy may ask of the motors, whatever is wrong with it, or ""."""
    asked = np.concatenate([targets.q, targets.kp, targets.kd])
    is_allowed = (asked >= _LEAST) & (asked <= _MOST)  # so that what is no number is not
    if is_allowed.all():
        return ""
    first = int(np.argmin(is_allowed))
    what, joint = _ASKED[first // JOINTS], G1_29[first % JOINTS]
    expected = "a number" if first < JOINTS else f"0 to {_MOST[first]:g}"
    return f"the policy asked for a {what} of {asked[first]:g} of {joint}; expected {expected}"
