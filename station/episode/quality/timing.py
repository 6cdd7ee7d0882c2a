"""What the times of an episode can say: whose they are, and which rules they cannot answer."""

from __future__ import annotations

from collections.abc import Mapping

from station.episode.quality.findings import Quality, TimesOf
from station.episode.storage.manifest import Manifest

IMPORTED = "imported"
"""Block of the manifest of an episode that another recorder made: where its times come from, among other things."""

_LOCK_STEP = "in lock-step commands wait for states"
_POLLED = "its recorder polled the keys, so no time is that of a write"
_NOMINAL = "its recorder wrote no times down; they are nominal"
_ENDS = ("began-late", "ended-early", "writer-gap")
_OF_THE_CONTROL = ("slow", "old-command", "misaligned", "jerky", "jerky-command", "velocity-scale")


_OF_STATES = ("gyro-scale", "position-jump", "repeated-states")
"""Rules that need to know when each state was written."""


def times_of(manifest: Manifest) -> TimesOf:
    """Return whose times an episode has."""
    imported = manifest.foreign.get(IMPORTED)
    times = imported.get("times") if isinstance(imported, Mapping) else None
    if not isinstance(times, Mapping):
        return "writers"
    return "polled" if times.get("source") == "measured" else "nominal"


def not_judged(quality: Quality) -> dict[str, str]:
    """Return the rules that the times of an episode cannot answer, and why, in a few words."""
    found: dict[str, str] = {}
    if quality.lock_step:
        own = set(_OF_THE_CONTROL) - {"velocity-scale"}  # its period is that of the contract
        found |= dict.fromkeys(sorted({"gap", "device-gap", "idle-ends", *_ENDS, *own}), _LOCK_STEP)
    if quality.times_of == "polled":
        found |= dict.fromkeys((*_OF_THE_CONTROL, *_OF_STATES), _POLLED)
    if quality.times_of == "nominal":
        found |= dict.fromkeys(
            ("gap", "device-gap", "camera-gap", "camera-slow", *_OF_THE_CONTROL, *_OF_STATES, "idle-ends"), _NOMINAL
        )
    return found


def told(silent: Mapping[str, str]) -> list[str]:
    """Return a line for each reason why rules were not asked."""
    return [
        f"{', '.join(name for name in silent if silent[name] == why)}: {why}" for why in dict.fromkeys(silent.values())
    ]
