"""A hand, or a pair of hands, on a robot's DDS network: reads its state and sends its commands.

Nothing is sent before the first arming. From then on every period sends a message: targets, or the command to go limp,
which drops what the hand holds. A hand has no controller of its own that must let go first. The buttons of the remote
that stop the robot stop the hand, too, if the robot's states reach it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds import messages, topics, types
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.other_writers import OtherWriters
from adapters.robots.g1.dds.remote import Remote
from adapters.robots.hands.options import HandOptions
from adapters.robots.hands.wire import HandWire
from station.bus import codec
from station.clock import SYSTEM, Clock
from station.errors import NotReady
from station.protocols import Fall, Floats, JointTargets, RobotState

SILENT_S = 0.3
"""A hand that said nothing for longer is not driven on [s]. No maker says how often one speaks."""

MOST_KP, MOST_KD = 4.0, 1.0
"""Greatest gains [N m/rad, N m s/rad]: 1.5 and 0.2 are what others use of a Dex3-1; the rest take none."""

_DEPTH = 256
_CLOSING_S = 0.1
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
_AT_REST = np.zeros(3)


class DdsHand:
    """Implements `station.protocols.Robot` and `SelfChecking`. Not thread safe.

    Args:
        wire: How it is spoken with.
        options: Where the robot is.
        control_dt_s: Control period [s].
        clock: Of the process.

    Raises:
        ConfigError: there is no such network interface.
        NotReady: the hand sent no state.
    """

    def __init__(self, wire: HandWire, options: HandOptions, control_dt_s: float, clock: Clock = SYSTEM) -> None:
        self._wire, self._options, self._dt_s, self._clock = wire, options, control_dt_s, clock
        self.joint_names = tuple(joint.name for joint in wire.joints)
        self._lower = np.array([joint.lower for joint in wire.joints])
        self._upper = np.array([joint.upper for joint in wire.joints])
        self._network = Network(options)
        self._states = self._network.reader(wire.state_topic, getattr(types, wire.state_type), _DEPTH)
        command_type = getattr(types, wire.command_type)
        self._commands = self._network.writer(wire.command_topic, raw(command_type))
        self._others = OtherWriters(self._network, wire.command_topic)
        self._robot = self._network.reader(topics.LOW_STATE, types.LowState, depth=2)
        self._remote = Remote()
        self._q = self._dq = np.zeros(len(wire.joints))
        self._heard_s = -np.inf
        self._states_read = self._malformed = 0
        self._error = self._bad_targets = ""
        self._has_sent = False
        self._rows: list[NDArray[np.float64]] = []
        self._pressure = np.zeros(0)
        try:
            self._await_first_state()
        except NotReady:
            self._network.close()
            raise

    def read(self) -> RobotState:
        """Return the newest measurement; what came before it since the last call goes to `values`."""
        self._take()
        self._others.poll()
        said = messages.intact_states(self._robot.take())
        if len(said):
            self._remote.update(np.ascontiguousarray(said["remote"]))
        return RobotState(self._clock.monotonic_ns(), self._q, self._dq, _UPRIGHT, _AT_REST)

    def _take(self) -> None:
        came = self._states.take()
        if not came:
            return
        measured = self._wire.measured(came)
        self._malformed += len(came) - (len(measured.rows) if measured is not None else 0)
        if measured is None:
            return
        self._states_read += len(measured.rows)
        self._rows.append(measured.rows)
        self._heard_s, self._error, self._pressure = self._clock.monotonic_s(), measured.error, measured.pressure
        self._q, self._dq = measured.q, measured.dq

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets within the joints' ranges, and return what was sent."""
        if self._bad_targets or (why_not := self._why_not_send(targets)):
            self._bad_targets = self._bad_targets or why_not
            self._send_limp()
            zeros: Floats = np.zeros(len(self._q))
            return JointTargets(self._q, zeros, zeros)
        q = np.clip(targets.q, self._lower, self._upper)
        self._commands.write(self._wire.command(q, targets.kp, targets.kd))
        self._has_sent = True
        return JointTargets(q, targets.kp, targets.kd)

    def damp(self) -> None:
        """Take the force out of it; one that was never armed is sent nothing."""
        self._bad_targets = ""  # it is disarmed: that was told
        self._send_limp()

    def _send_limp(self) -> None:
        if self._has_sent:
            self._commands.write(self._wire.limp(self._q))

    def fallen(self) -> Fall | None:
        """A hand cannot fall."""
        return None

    def why_not_arm(self) -> str:
        """Return why it must not be armed, or ""."""
        return self.why_not_drive() or self.why_stand()

    def why_not_drive(self) -> str:
        """Return why the force has to go out of it now, or ""."""
        silent_s = self._clock.monotonic_s() - self._heard_s
        if stop := self._remote.stop:
            return f"{stop} on the remote"
        if silent_s > SILENT_S:
            return f"no state of the hand for {silent_s:.2f} s on {self._wire.state_topic}"
        if not np.isfinite(self._q).all():
            return "the hand reports what is no number"
        return self._bad_targets or self._others.why_not()

    def why_stand(self) -> str:
        """Return why it has to stay where it is, to be limp a moment later, or ""."""
        return self._error

    def pop_actions(self) -> list[str]:
        """A hand has no buttons."""
        return []

    def release(self) -> None:
        """Nothing else has its motors."""

    def releasing(self) -> tuple[bool, str]:
        """There is nothing to release."""
        return False, "a hand has no controller of its own"

    def values(self) -> Mapping[str, bytes]:
        """Return what was measured since the last call, by the name of its stream."""
        found = {"samples": codec.f64(np.concatenate(self._rows).ravel())} if self._rows else {}
        if self._rows and self._pressure.size:
            found["pressure"] = codec.f64(self._pressure)
        self._rows = []
        return found

    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""
        return {"states": self._states_read, "states_malformed": self._malformed, "why_not_arm": self.why_not_arm()}

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of it."""
        return {
            "backend": "dds",
            "interface": self._options.interface,
            "domain": self._options.domain,
            "topic": self._wire.command_topic,
        }

    def close(self) -> None:
        """Leave it limp."""
        until_s = self._clock.monotonic_s() + _CLOSING_S * self._has_sent
        while self._clock.monotonic_s() < until_s:
            self.damp()
            self._clock.sleep(self._dt_s)
        self._network.close()

    def _await_first_state(self) -> None:
        until_s = self._clock.monotonic_s() + self._options.first_state_within_s
        while self._heard_s == -np.inf:
            self._take()
            self._clock.sleep(self._dt_s)
            if self._heard_s == -np.inf and self._clock.monotonic_s() > until_s:
                came = (
                    f"{self._malformed} messages came that are no states of it" if self._malformed else "nothing came"
                )
                raise NotReady(
                    f"no state of the hand within {self._options.first_state_within_s:g} s on "
                    f"{self._wire.state_topic} ({self._options.interface}, domain {self._options.domain}); {came}: "
                    "is it this kind of hand, does its service run, does it have power?"
                )

    def _why_not_send(self, targets: JointTargets) -> str:
        """Return what no command may ask of a hand, or ""."""
        for what, values, most in (("stiffness", targets.kp, MOST_KP), ("damping", targets.kd, MOST_KD)):
            odd = ~((values >= 0.0) & (values <= most))  # so that what is no number is odd
            if odd.any():
                worst = int(np.argmax(odd))
                return f"a {what} of {values[worst]:g} was asked of {self.joint_names[worst]}; at most {most:g}"
        return "" if np.isfinite(targets.q).all() else "a position was asked for that is no number"
