"""What each tune of a cue sounds like: notes, told apart by direction and length as well as pitch, and samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from station.operator.voice import Tune

Samples = npt.NDArray[np.int16]

NOTES: dict[Tune, tuple[tuple[float, float], ...]] = {
    "up": ((523.25, 0.08), (783.99, 0.14)),
    "down": ((783.99, 0.08), (523.25, 0.14)),
    "note": ((659.26, 0.12),),
    "no": ((233.08, 0.12), (0.0, 0.06), (233.08, 0.18)),
    "lost": ((880.0, 0.10), (622.25, 0.10), (440.0, 0.24)),
    "begin": ((523.25, 0.07), (659.26, 0.07), (783.99, 0.07), (1046.5, 0.16)),
    "end": ((1046.5, 0.07), (783.99, 0.07), (659.26, 0.07), (523.25, 0.16)),
    "alarm": ((987.77, 0.16), (739.99, 0.16)) * 3,
}
"""Pitch [Hz], 0 for a rest, and length [s] of each note."""

_FADE_S = 0.006  # a tone that begins or ends at once clicks
_FULL = 32767


def seconds(tune: Tune) -> float:
    """Return how long a tune takes [s]."""
    return sum(length_s for _, length_s in NOTES[tune])


def samples(tune: Tune, rate_hz: int, volume: float = 0.5) -> Samples:
    """Return a tune as one channel of 16 bits, shape (n,).

    Args:
        tune: Which one.
        rate_hz: Samples per second [Hz].
        volume: Peak, 0 to 1 of what the format holds.
    """
    return np.concatenate([_note(pitch_hz, length_s, rate_hz, volume) for pitch_hz, length_s in NOTES[tune]])


def _note(pitch_hz: float, length_s: float, rate_hz: int, volume: float) -> Samples:
    count = round(length_s * rate_hz)
    ends = max(1, round(_FADE_S * rate_hz))
    from_end: Any = np.minimum(np.arange(count), np.arange(count)[::-1])
    loudness = volume * (0.5 - 0.5 * np.cos(np.pi * np.minimum(from_end / ends, 1.0)))
    wave = np.sin(2.0 * np.pi * pitch_hz * np.arange(count) / rate_hz)
    return np.asarray(np.rint(_FULL * loudness * wave), dtype=np.int16)
