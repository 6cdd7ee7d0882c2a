"""A sound file of what was said when: tones at their times, and the words as labels beside it (Audacity's format)."""

from __future__ import annotations

import time
import wave
from pathlib import Path

import msgspec
import numpy as np

from adapters.cues import tunes
from station.errors import BadFile
from station.operator.voice import Cue, Hush

RATE_HZ = 16000
_SLICE_S = 0.04
_MOST_FILES = 1000


class WavOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the voice `wav`.

    Attributes:
        file: Sound file to be written; one that is there is kept, and a number is added to the name.
        volume: Loudness of the tones, 0 to 1.
    """

    file: Path = Path("cues.wav")
    volume: float = 0.5

    def __post_init__(self) -> None:
        if self.file.suffix != ".wav":
            raise ValueError(f"file is {str(self.file)!r}; expected a name that ends in .wav")
        if not 0.0 < self.volume <= 1.0:
            raise ValueError(f"volume is {self.volume:g}; expected more than 0, up to 1")


class Wav:
    """Implements `station.operator.voice.Voice`. The file begins when the voice is made, and is whole after each cue.

    Attributes:
        file, labels: What is written: sound, and a line ``begin end words`` for each cue, times in seconds.

    Raises:
        BadFile: it cannot be written.
    """

    def __init__(self, options: WavOptions) -> None:
        self._volume = options.volume
        self.file = _new(options.file)
        self.labels = self.file.with_suffix(".txt")
        try:
            self._words = self.labels.open("w", encoding="utf-8")
            self._sound = wave.open(str(self.file), "wb")  # noqa: SIM115  closed with the voice
        except OSError as error:
            raise self._cannot_be_written(error) from None
        self._sound.setparams((1, 2, RATE_HZ, 0, "NONE", ""))
        self._began_s = time.monotonic()

    def play(self, cue: Cue, hush: Hush) -> None:
        """Write the tune of a cue where it is now, as long as it lasts.

        Raises:
            BadFile: it cannot be written.
        """
        tune = tunes.samples(cue.tune, RATE_HZ, self._volume)
        step = round(_SLICE_S * RATE_HZ)
        try:
            self._pad(round((time.monotonic() - self._began_s) * RATE_HZ))
            begin_s = self._sound.tell() / RATE_HZ
            for start in range(0, len(tune), step):
                self._sound.writeframes(tune[start : start + step].tobytes())
                if hush(_SLICE_S):
                    break
            self._words.write(f"{begin_s:.6f}\t{self._sound.tell() / RATE_HZ:.6f}\t{cue.words}\n")
            self._words.flush()
        except OSError as error:
            raise self._cannot_be_written(error) from None

    def close(self) -> None:
        """Close both files.

        Raises:
            BadFile: they cannot be written to their ends.
        """
        try:
            with self._words:
                self._sound.close()
        except OSError as error:
            raise self._cannot_be_written(error) from None

    def _pad(self, until: int) -> None:
        """Write silence up to a frame, in pieces: an hour of it is a hundred megabytes."""
        while (left := until - self._sound.tell()) > 0:
            self._sound.writeframes(np.zeros(min(left, RATE_HZ * 60), dtype=np.int16).tobytes())

    def _cannot_be_written(self, error: OSError) -> BadFile:
        return BadFile(f"{self.file}: cannot be written: {error.strerror}")


def _new(file: Path) -> Path:
    """Return a name that no file has yet."""
    for number in range(1, _MOST_FILES):
        name = file if number == 1 else file.with_stem(f"{file.stem}-{number}")
        if not name.exists():
            return name
    raise BadFile(f"{file}: there are {_MOST_FILES} of them already; remove some, or name another file")
