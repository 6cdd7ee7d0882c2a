"""Tones through the sound card, by pygame's SDL: needs no program and no system library beside the sound system."""

from __future__ import annotations

import importlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec

from adapters.cues import tunes
from station.operator.device import DeviceError
from station.operator.voice import Cue, Hush

RATE_HZ = 44100
_LOOK_S = 0.02
_LATE_S = 1.0  # a card that takes longer than the tune and this does not play
_STDERR = 2
_ANEW = "plug it in again, and start this server anew"


class TonesOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the voice `tones`.

    Attributes:
        volume: Loudness of the tones, 0 to 1.
        device: Name of the sound output; "" for the system's own choice.
    """

    volume: float = 0.5
    device: str = ""

    def __post_init__(self) -> None:
        if not 0.0 < self.volume <= 1.0:
            raise ValueError(f"volume is {self.volume:g}; expected more than 0, up to 1")


class Tones:
    """Implements `station.operator.voice.Voice`.

    Raises:
        DeviceError: pygame is not installed, or there is no sound output.
    """

    def __init__(self, options: TonesOptions) -> None:
        self._volume = options.volume
        self._mixer = _import_mixer()
        self._error = importlib.import_module("pygame").error
        with _words_of_the_sound_system() as words:
            try:
                self._mixer.init(RATE_HZ, -16, 1, 512, devicename=options.device or None, allowedchanges=0)
            except self._error as error:
                raise DeviceError(_no_output(options.device, f"{error}", words())) from None

    def play(self, cue: Cue, hush: Hush) -> None:
        """Play the tune of a cue.

        Raises:
            DeviceError: the sound output plays nothing.
        """
        try:
            self._play(cue, hush)
        except self._error as error:
            raise DeviceError(f"the sound output fails ({error}); {_ANEW}") from None

    def close(self) -> None:
        """Let the sound output go."""
        self._mixer.quit()

    def _play(self, cue: Cue, hush: Hush) -> None:
        sound = self._mixer.Sound(buffer=tunes.samples(cue.tune, RATE_HZ, self._volume).tobytes())
        channel = sound.play()
        if channel is None:
            raise DeviceError(f"the sound output has no channel left; {_ANEW}")
        left_s = tunes.seconds(cue.tune) + _LATE_S
        while channel.get_busy():
            if hush(_LOOK_S):
                channel.stop()
                return
            left_s -= _LOOK_S
            if left_s < 0.0:
                channel.stop()
                raise DeviceError(f"the sound output has ceased to play; {_ANEW}")


def missing() -> str:
    """Return what this machine lacks for tones; "" for nothing."""
    try:
        Tones(TonesOptions()).close()
    except DeviceError as error:
        return str(error)
    return ""


def _import_mixer() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        return importlib.import_module("pygame.mixer")
    except ImportError as error:
        raise DeviceError(
            f"tones need pygame, which is not installed ({error}); pip install 'teleop-station[cues]'"
        ) from None


def _no_output(device: str, error: str, words: str) -> str:
    what = f"no sound output {device!r}" if device else "no sound output"
    return f"{what} ({error or words}); plug one in, or take the voice `wav`; options.tones.device names another"


@contextmanager
def _words_of_the_sound_system() -> Iterator[Any]:
    """Catch what the sound system's libraries write past Python to the standard error; give its last line."""
    with tempfile.TemporaryFile() as file:
        saved = os.dup(_STDERR)
        os.dup2(file.fileno(), _STDERR)

        def last_line() -> str:
            lines = os.pread(file.fileno(), 1 << 16, 0).decode(errors="replace").splitlines()
            return " ".join(lines[-1].split()) if lines else ""

        try:
            yield last_line
        finally:
            os.dup2(saved, _STDERR)
            os.close(saved)
