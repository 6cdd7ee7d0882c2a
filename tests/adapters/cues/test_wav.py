"""A sound file of what was said when."""

from __future__ import annotations

import threading
import wave
from pathlib import Path

import msgspec
import numpy as np
import pytest

from adapters.cues import tunes
from adapters.cues.wav import RATE_HZ, Wav, WavOptions
from station.errors import BadFile
from station.operator.voice import Cue
from tests.adapters.cues.test_tunes import pitches

NEVER = threading.Event().wait


def read(file: Path) -> tunes.Samples:
    with wave.open(str(file), "rb") as sound:
        assert (sound.getnchannels(), sound.getsampwidth(), sound.getframerate()) == (1, 2, RATE_HZ)
        return np.frombuffer(sound.readframes(sound.getnframes()), dtype=np.int16)


def labels(file: Path) -> list[tuple[float, float, str]]:
    lines = (line.split("\t") for line in file.read_text().splitlines())
    return [(float(begin), float(end), words) for begin, end, words in lines]


def test_each_cue_stands_at_its_time_with_its_words(tmp_path: Path) -> None:
    voice = Wav(WavOptions(file=tmp_path / "cues.wav"))
    voice.play(Cue(words="engaged", tune="up"), NEVER)
    threading.Event().wait(0.3)
    voice.play(Cue(words="emergency stop", tune="alarm"), NEVER)
    samples, told = read(voice.file), labels(voice.labels)  # whole before it is closed: a killed server leaves it so
    voice.close()
    assert [words for _, _, words in told] == ["engaged", "emergency stop"]
    for (begin_s, end_s, _), tune in zip(told, ("up", "alarm"), strict=True):
        said = samples[round(begin_s * RATE_HZ) : round(end_s * RATE_HZ)]
        assert len(said) == len(tunes.samples(tune, RATE_HZ))
        assert pitches(said, tune) == pytest.approx([pitch for pitch, _ in tunes.NOTES[tune]], abs=5.0)
    between = samples[round(told[0][1] * RATE_HZ) : round(told[1][0] * RATE_HZ)]
    assert len(between) > 0.25 * RATE_HZ
    assert not between.any()


def test_what_is_broken_off_ends_there(tmp_path: Path) -> None:
    voice = Wav(WavOptions(file=tmp_path / "cues.wav"))
    voice.play(Cue(words="emergency stop", tune="alarm"), lambda _wait_s: True)
    voice.close()
    assert 0 < len(read(voice.file)) < len(tunes.samples("alarm", RATE_HZ)) / 10 + RATE_HZ


def test_a_file_that_is_there_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "cues.wav"
    file.write_bytes(b"mine")
    first, second = (Wav(WavOptions(file=file)) for _ in range(2))
    assert [first.file.name, second.file.name] == ["cues-2.wav", "cues-3.wav"]
    assert file.read_bytes() == b"mine"
    first.close()
    second.close()


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"cues\.wav: cannot be written: No such file or directory"):
        Wav(WavOptions(file=tmp_path / "none" / "cues.wav"))
    with pytest.raises(msgspec.ValidationError, match=r"ends in \.wav"):
        msgspec.convert({"file": "cues.mp3"}, WavOptions, dec_hook=lambda kind, value: kind(value))
