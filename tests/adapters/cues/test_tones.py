"""Tones through the real SDL, with a file in place of a sound card."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from adapters.cues import tunes
from adapters.cues.tones import RATE_HZ, Tones, TonesOptions, missing
from station.operator.device import DeviceError
from station.operator.voice import Cue
from tests.adapters.cues.test_tunes import pitches
from tests.waiting import wait_until

pygame = pytest.importorskip("pygame")


@pytest.fixture
def card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that SDL plays into, and waits as a card would."""
    file = tmp_path / "played.raw"
    monkeypatch.setenv("SDL_AUDIODRIVER", "disk")
    monkeypatch.setenv("SDL_DISKAUDIOFILE", str(file))
    return file


def played(card: Path) -> tunes.Samples:
    """Return what was played, silence before and after it left out."""
    samples = np.frombuffer(card.read_bytes(), dtype=np.int16)
    (loud,) = np.nonzero(samples)
    return samples[loud[0] - 1 : loud[-1] + 2] if len(loud) else samples[:0]


def test_the_tune_reaches_the_card_sample_by_sample(card: Path) -> None:
    voice = Tones(TonesOptions(volume=0.25))
    voice.play(Cue(words="recording take 7", tune="begin"), threading.Event().wait)
    voice.close()
    heard, meant = played(card), tunes.samples("begin", RATE_HZ, 0.25)
    assert len(heard) == pytest.approx(len(meant), abs=20)
    assert pitches(heard, "begin", RATE_HZ) == pytest.approx([pitch for pitch, _ in tunes.NOTES["begin"]], abs=8.0)
    assert np.abs(heard).max() == pytest.approx(np.abs(meant).max(), rel=0.05)


def test_a_cue_is_broken_off_within_a_moment(card: Path) -> None:
    voice = Tones(TonesOptions())
    said = threading.Event()

    def hush(wait_s: float) -> bool:
        time.sleep(wait_s)
        return card.exists() and len(played(card)) > 0

    voice.play(Cue(words="emergency stop", tune="alarm"), hush)
    before = len(played(card))
    voice.play(Cue(words="engaged", tune="up"), said.wait)
    wait_until(lambda: len(played(card)) > before)
    voice.close()
    assert before < 0.8 * len(tunes.samples("alarm", RATE_HZ))


def test_an_output_that_is_gone_is_told_with_each_cue(card: Path) -> None:
    voice = Tones(TonesOptions())
    pygame.mixer.quit()
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"^the sound output fails \(mixer not initialized\); plug it in again"):
            voice.play(Cue(words="engaged", tune="up"), threading.Event().wait)
    voice.close()


def test_no_card_is_one_line_that_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("SDL_AUDIODRIVER", "alsa")
    monkeypatch.setenv("ALSA_CONFIG_PATH", "/nowhere")
    told = missing()
    assert told.startswith("no sound output (")
    assert "take the voice `wav`" in told
    assert "\n" not in told
    assert capfd.readouterr().err == "", "the sound system's own words stay within"
    with pytest.raises(DeviceError, match="no sound output 'headset'"):
        Tones(TonesOptions(device="headset"))


def test_without_the_library_it_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame.mixer", None)
    assert "pip install 'teleop-station[cues]'" in missing()
