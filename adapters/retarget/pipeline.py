"""A body in, a `station.protocols.Reference` out, at the rate of the device."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any

import numpy as np

from adapters.retarget.anchor import Anchor
from adapters.retarget.body_ik import BodyIK
from adapters.retarget.calibration import Calibration
from adapters.retarget.contact import FootHold
from adapters.retarget.scaling import Scaler
from adapters.retarget.smoothing import BodySmoother
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.bus.joints import SMPL_24
from station.errors import StationError
from station.operator.sample import Body
from station.protocols import Floats, Reference

PAUSE_S = 0.25
"""After so long without a new sample velocities begin at zero, and where the operator went meanwhile means nothing."""

_NOMINAL_S = 0.01


class BodyLost(StationError):
    """There is no body in a sample, or one that cannot be; one line that says what is wrong with it."""


class BodyRetarget:
    """Whole-body retargeting onto the G1, layer by layer; each may be given, or its successor.

    Args:
        calibration: Of the operator.
        smoother, hold, ik, velocity: Layers in place of the default ones.
    """

    joint_names = G1_29
    """Joints of what `step` returns, in its order."""

    def __init__(
        self,
        calibration: Calibration,
        *,
        smoother: BodySmoother | None = None,
        hold: FootHold | None = None,
        ik: BodyIK | None = None,
        velocity: RootVelocity | None = None,
    ) -> None:
        self.calibration = calibration
        self.anchor = Anchor()
        self.smoother = smoother or BodySmoother()
        self.scaler = Scaler(calibration)
        self.hold = hold or FootHold()
        self.ik = ik or BodyIK()
        self.velocity = velocity or RootVelocity()
        self._newest: tuple[int, Reference] | None = None

    def reset(self) -> None:
        """Begin anew: the next body is met at once, without a limit on speeds."""
        self.anchor.reset()
        self._forget_motion()
        self.ik.reset()
        self._newest = None

    def step(self, body: Body | None, capture_ns: int) -> Reference:
        """Return what the robot shall do.

        A sample that was seen before (by its time) gives the same reference again. After a pause, or a leap of the
        tracking, the reference goes on from where it was: joints and root at bounded speeds, velocities from zero.

        Args:
            body: As tracked; None where the device sees none.
            capture_ns: When, on the device's clock [ns].

        Raises:
            BodyLost: no body, or not a possible one. The state stays as it was, the next good body goes on from it.
        """
        found = checked(body)
        if self._newest is not None and capture_ns == self._newest[0]:
            return self._newest[1]
        dt_s = _NOMINAL_S if self._newest is None else (capture_ns - self._newest[0]) * 1e-9
        is_pause = self._newest is not None and not 0.0 < dt_s <= PAUSE_S  # a clock that went back is another clock
        if is_pause:
            self._forget_motion()
            dt_s = _NOMINAL_S
        jumps = self.anchor.jumps
        placed = self.anchor.step(found, moved=is_pause)
        if self.anchor.jumps != jumps:
            self._forget_motion()
        aim = self.hold.step(self.scaler.step(self.smoother.step(placed, dt_s)), dt_s)
        reference = self._referred(self.ik.step(aim, dt_s), capture_ns * 1e-9)
        self._newest = (capture_ns, reference)
        return reference

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of the retargeting: whose body, what its layers are set to, how late they are."""
        known = self.calibration
        return {
            "operator": known.operator,
            "calibrated": {"pose": known.pose, "date": known.date, "height_m": known.height_m},
            "leg_scale": round(self.scaler.scale, 4),
            "lengths_m": dataclasses.asdict(known.lengths_m),
            "ik": self.ik.facts(),
            "latency_s": {
                "smoothing_at_1_mps": round(self.smoother.latency_s(1.0), 4),
                "velocity": self.velocity.latency_s,
            },
        }

    def _referred(self, qpos: Floats, time_s: float) -> Reference:
        position, quat, q = qpos[:3], qpos[3:7], qpos[7:]
        linear, angular = self.velocity.step(position, quat, time_s)
        return Reference(root_pos=position, root_quat_wxyz=quat, root_lin_vel=linear, root_ang_vel=angular, q=q)

    def _forget_motion(self) -> None:
        self.smoother.reset()
        self.hold.reset()
        self.velocity.reset()


def checked(body: Body | None) -> Body:
    """Return a body that can be one.

    Raises:
        BodyLost: None, wrong shapes, values that are not finite, no orientations, or all joints at one place.
    """
    if body is None:
        raise BodyLost("the device sees no body; are the trackers on, and is body tracking started in the headset?")
    count = len(SMPL_24)
    if body.positions.shape != (count, 3) or body.quats_wxyz.shape != (count, 4):
        raise BodyLost(
            f"the body has shapes {body.positions.shape} and {body.quats_wxyz.shape}, "
            f"expected ({count}, 3) and ({count}, 4)"
        )
    bad = ~(np.isfinite(body.positions).all(axis=1) & np.isfinite(body.quats_wxyz).all(axis=1))
    if bad.any():
        raise BodyLost(f"joint {SMPL_24[int(bad.argmax())]} of the body is not finite; expected metres and quaternions")
    norms = np.sqrt((body.quats_wxyz**2).sum(axis=1))
    if (np.abs(norms - 1.0) > 0.01).any():
        worst = int(np.abs(norms - 1.0).argmax())
        raise BodyLost(f"joint {SMPL_24[worst]} has a quaternion of length {norms[worst]:.2f}, expected 1")
    if np.abs(body.positions).max() > 100.0 or np.ptp(body.positions, axis=0).max() < 0.3:
        raise BodyLost("the joints of the body are at one place, or a hundred metres away; the tracking is lost")
    return body


class RootVelocity:
    """The slope of a straight line through the samples of a short window; it is half the window late.

    Args:
        window_s: Length of the window [s]; two samples are always in it.
    """

    def __init__(self, window_s: float = 0.06) -> None:
        self.latency_s = window_s / 2.0
        self._window_s = window_s
        self._samples: deque[tuple[float, Floats, Floats]] = deque(maxlen=64)

    def reset(self) -> None:
        """Forget everything; velocities begin at zero."""
        self._samples.clear()

    def step(self, position: Floats, quat_wxyz: Floats, time_s: float) -> tuple[Floats, Floats]:
        """Return linear [m/s] and angular velocity [rad/s] of the root in its own frame, shape (3,) each.

        Args:
            position: Of the root, shape (3,) [m].
            quat_wxyz: Its orientation, shape (4,).
            time_s: When it was captured; later than the last one [s].
        """
        self._samples.append((time_s, position, quat_wxyz))
        while len(self._samples) > 2 and time_s - self._samples[0][0] > self._window_s + 1e-6:
            self._samples.popleft()
        if len(self._samples) < 2:
            return np.zeros(3), np.zeros(3)
        times = np.array([sample[0] for sample in self._samples])
        places = np.array([sample[1] for sample in self._samples])
        quats = np.array([sample[2] for sample in self._samples])
        # Turns as seen from the newest orientation, in its own frame: within a window they are small.
        turns = rotations.rotation_vector(rotations.multiply(rotations.inverse(quat_wxyz)[None], quats))
        off = times - times.mean()
        slope = off / (off @ off)
        return rotations.rotate_inverse(quat_wxyz, slope @ places), slope @ turns
