"""An arm's session without an arm: it goes at a speed to its target, and faults and refuses when told to."""

from __future__ import annotations

from typing import Any

import numpy as np

from station.arms import ArmState
from station.protocols import Floats

TICK_S = 0.004


class IdealArm:
    """Implements `station.arms.ArmSession`; `pass_tick` moves it."""

    is_simulated = True

    def __init__(self, *, speed_rad_s: float = 0.3, lead_rad: float = 0.015) -> None:
        self.speed_rad_s, self.lead_rad = speed_rad_s, lead_rad
        self.q = np.array([0.0, 0.35, 0.0, 1.6, 0.0, 1.19, 0.0])
        self.goal: Floats = self.q.copy()
        self.fault = self.why_blocked = self.refusal = self.target_refusal = ""  # `refusal` refuses to be engaged, too
        self.is_engaged = False
        self.sent: list[Floats] = []
        self.engaged_at: list[Floats] = []
        self.releases = 0

    @property
    def is_moving(self) -> bool:
        return not np.array_equal(self.goal, self.q)

    def pass_tick(self) -> None:
        self.q = self.q + np.clip(self.goal - self.q, -self.speed_rad_s * TICK_S, self.speed_rad_s * TICK_S)

    def read(self) -> ArmState:
        return ArmState(1, self.q.copy(), self.is_moving, self.is_engaged, self.fault, self.why_blocked, None)

    def engage(self) -> str:
        if self.refusal:
            return self.refusal
        self.is_engaged = True
        self.engaged_at.append(self.q.copy())
        return ""

    def send(self, q: Floats) -> str:
        assert self.is_engaged
        if refusal := self.refusal or self.target_refusal:
            return refusal
        self.sent.append(q)
        self.goal = q
        return ""

    def release(self) -> None:
        self.is_engaged = False
        self.releases += 1

    def clear(self) -> str:
        self.fault = ""
        return ""

    def health(self) -> dict[str, Any]:
        return {}
