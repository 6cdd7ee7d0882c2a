"""What was found in a motion file and what was done about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

_SHOWN = 20  # findings listed in a manifest; the number of all of them stands beside


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing wrong with one frame, or with the step from it to `to_frame`."""

    frame: int
    what: str
    value: float
    limit: float
    unit: str = ""
    to_frame: int | None = None

    def __str__(self) -> str:
        where = f"frame {self.frame}" if self.to_frame is None else f"frames {self.frame}->{self.to_frame}"
        return f"{where}: {self.what} {self.value:.4g} {self.unit}".rstrip() + f" (limit {self.limit:.4g})"


@dataclass(frozen=True, slots=True)
class RangeViolation:
    """A joint beyond its range: reported, and clamped at the gate, but no reason to refuse a motion."""

    joint: str
    frames: int
    worst_rad: float
    at_frame: int

    def __str__(self) -> str:
        worst = f"at frame {self.at_frame} by {self.worst_rad:.3f} rad"
        return f"{self.joint} is beyond its range in {self.frames} frames, {worst}"


@dataclass(frozen=True, slots=True)
class Report:
    """What was found in a file and what was done; frames are numbered from 0 as in the file.

    Attributes:
        frames: Frames in the file.
        first, last: The frames that are used, both included.
        bridged: Holes inside, as (first, last) bad frame, that were filled by interpolation.
        findings: Every bad frame and step.
        violations: Joints beyond their range in the frames that are used.
    """

    frames: int
    first: int
    last: int
    bridged: tuple[tuple[int, int], ...]
    findings: tuple[Finding, ...]
    violations: tuple[RangeViolation, ...]

    @property
    def trimmed(self) -> tuple[int, int]:
        """Number of frames cut off at the start and at the end."""
        return self.first, self.frames - 1 - self.last

    def lines(self) -> list[str]:
        """Return the report for people; empty when there is nothing to say."""
        lines = [str(finding) for finding in self.findings[:_SHOWN]]
        if len(self.findings) > _SHOWN:
            lines.append(f"… and {len(self.findings) - _SHOWN} more")
        if any(self.trimmed):
            lines.append(f"trimmed: {self.trimmed[0]} frames at the start, {self.trimmed[1]} at the end")
        lines += [f"bridged: frames {first} to {last}" for first, last in self.bridged]
        return lines + [str(violation) for violation in self.violations]

    def facts(self) -> dict[str, Any]:
        """Return the report for a manifest."""
        return {
            "frames_in_file": self.frames,
            "first_frame": self.first,
            "last_frame": self.last,
            "trimmed": {"start": self.trimmed[0], "end": self.trimmed[1]},
            "bridged": [list(hole) for hole in self.bridged],
            "bad_frames": [str(finding) for finding in self.findings[:_SHOWN]],
            "bad_frames_found": len(self.findings),
            "beyond_range": [str(violation) for violation in self.violations],
        }
