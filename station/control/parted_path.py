"""The command paths of a robot whose parts are commanded apart: a gate for each part, arming and stop for all.

What one part is let through depends on its own command alone: a pedal that falls silent stops the walk, and the arms go
on. Pure: no bus, no robot, no clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from station.bus import codec
from station.control.arming import Arming
from station.control.command_path import CommandPath, StepEvent
from station.control.command_validator import CommandSample, Samples
from station.control.envelope import Envelope, of_parts
from station.control.gate import Decision, GateConfig, State
from station.parts import PartedCommand, by_key, part_name
from station.protocols import CommandFormat, Floats

_MOST_OF_ALL: tuple[State, ...] = (
    "stopped", "faulted", "tracking", "entering", "holding", "returning", "waiting",
)  # fmt: skip


def samples_of(command_format: CommandFormat, vector: Floats, at_s: float, writer: str = "") -> Samples:
    """Return a command, shape (m,), as if it had just been read from the bus, in each of its parts [s]."""
    samples = [
        CommandSample(codec.json_vector(each), arrived_s=at_s, source=writer)
        for each in by_key(command_format, vector).values()
    ]
    return tuple(samples) if len(samples) > 1 else samples[0]


class PartedPath(CommandPath):
    """As `CommandPath`, of several parts; `gate` and `validator` are those of the first.

    Args:
        command_format: Of the parts.
        config: Times of each gate.
        arming: Of the robot.
        envelopes: Of its policies, each of one part.
    """

    def __init__(
        self, command_format: PartedCommand, config: GateConfig, arming: Arming, *, envelopes: Sequence[Envelope] = ()
    ) -> None:
        step_events: list[StepEvent] = []
        self._paths = tuple(
            CommandPath(
                part, config, arming, part=part_name(command_format, part), step_events=step_events, envelopes=own
            )
            for part, own in zip(command_format.parts, of_parts(envelopes, command_format.parts), strict=True)
        )
        self.command_format, self.part, self.arming, self._step_events = command_format, "", arming, step_events
        self.gate, self.validator = self._paths[0].gate, self._paths[0].validator

    @property
    def paths(self) -> tuple[CommandPath, ...]:
        """Of the parts."""
        return self._paths

    @property
    def state(self) -> State:
        """What the robot does most of all: it is stopped or faulted, follows one part's command, or none."""
        return min((path.gate.state for path in self._paths), key=_MOST_OF_ALL.index)

    @property
    def reason(self) -> str:
        """Why each part is in its state."""
        return "; ".join(f"{path.part} {path.gate.state}: {path.gate.reason}" for path in self._paths)

    def decide(self, sample: Samples, now_s: float, *, why_blocked: str = "") -> Decision:
        """Read the newest command of each part and return what the gates let through."""
        samples = sample if isinstance(sample, tuple) else (sample,) + (None,) * (len(self._paths) - 1)
        parts = tuple(
            path.decide(each, now_s, why_blocked=why_blocked) for path, each in zip(self._paths, samples, strict=True)
        )
        starts = np.cumsum([0, *(len(part.vector) for part in parts)]).tolist()[:-1]
        return Decision(
            state=self.state,
            vector=np.concatenate([part.vector for part in parts]),
            reason=self.reason,
            age_s=min(part.age_s for part in parts),
            transitions=(),
            limited=tuple(start + index for start, part in zip(starts, parts, strict=True) for index in part.limited),
            beyond=tuple(start + index for start, part in zip(starts, parts, strict=True) for index in part.beyond),
            parts=parts,
            at_s=now_s,
        )

    def status(self, decision: Decision) -> dict[str, Any]:
        """Return what the robot's `command_gate` tells of a step, that of each part by its name beside it."""
        parts = {path.part: path.status(part) for path, part in zip(self._paths, decision.parts, strict=True)}
        told = super().status(decision)
        return told | {
            "clamped": any(part["clamped"] for part in parts.values()),
            "refused": sum(part["refused"] for part in parts.values()),
            "needs_silence": "; ".join(filter(None, (part["needs_silence"] for part in parts.values()))),
            "parts": parts,
        }
