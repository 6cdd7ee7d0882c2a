"""Tunes are what they are written as: their pitches by Fourier transform, without clicks, each unlike the others."""

from __future__ import annotations

from itertools import combinations
from typing import get_args

import numpy as np
import pytest

from adapters.cues import tunes
from station.operator.voice import Tune

RATE_HZ = 16000


def pitches(samples: tunes.Samples, tune: Tune, rate_hz: int = RATE_HZ) -> list[float]:
    """Return the strongest pitch of each note of a tune [Hz]; 0 for silence."""
    found, begin = [], 0
    for _, length_s in tunes.NOTES[tune]:
        note = samples[begin : begin + round(length_s * rate_hz)].astype(float)
        begin += len(note)
        spectrum = np.abs(np.fft.rfft(note, 16 * len(note)))
        found.append(float(spectrum.argmax() * rate_hz / (16 * len(note))) if note.any() else 0.0)
    return found


@pytest.mark.parametrize("tune", get_args(Tune))
def test_every_tune_has_its_pitches_and_its_length(tune: Tune) -> None:
    samples = tunes.samples(tune, RATE_HZ)
    assert len(samples) == pytest.approx(tunes.seconds(tune) * RATE_HZ, abs=len(tunes.NOTES[tune]))
    assert pitches(samples, tune) == pytest.approx([pitch for pitch, _ in tunes.NOTES[tune]], abs=5.0)
    assert 0.45 < np.abs(samples.astype(float)).max() / 32767 <= 0.5001
    assert np.abs(np.diff(samples.astype(float))).max() < 32767 * 0.5 * 2 * np.pi * 1100 / RATE_HZ, "no clicks"


def test_a_louder_voice_is_louder() -> None:
    quiet, loud = (int(np.abs(tunes.samples("note", RATE_HZ, volume)).max()) for volume in (0.1, 1.0))
    assert loud == pytest.approx(10 * quiet, rel=0.01)


def test_no_two_tunes_are_alike_and_none_is_long() -> None:
    assert all(tunes.NOTES[one] != tunes.NOTES[other] for one, other in combinations(tunes.NOTES, 2))
    assert max(tunes.seconds(tune) for tune in tunes.NOTES) <= 1.0
    assert set(tunes.NOTES) == set(get_args(Tune))
