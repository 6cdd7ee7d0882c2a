"""Speech by a program of the system: espeak-ng, speech-dispatcher's spd-say, or macOS's say. Never through a shell."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from station.operator.device import DeviceError
from station.operator.voice import Cue, Hush

_LOOK_S = 0.05
_LONGEST_S = 20.0
_ENDS_S = 1.0
_USUAL_WPM = 175  # of espeak-ng; spd-say counts from -100 to 100 about its own


class SpeechOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the voice `speech`.

    Attributes:
        program: espeak-ng, espeak, spd-say or say; "" for the first of them that is installed.
        voice: Name of one of the program's voices or languages, such as ``en-us``; "" for its own choice.
        words_per_minute: How fast it speaks.
    """

    program: str = ""
    voice: str = ""
    words_per_minute: int = 190

    def __post_init__(self) -> None:
        if self.program and self.program not in PROGRAMS:
            raise ValueError(f"program is {self.program!r}; expected one of {', '.join(PROGRAMS)}")
        if not 80 <= self.words_per_minute <= 450:
            raise ValueError(f"words_per_minute is {self.words_per_minute}; expected 80 to 450")
        if self.voice.startswith("-") or not self.voice.isprintable():
            raise ValueError(f"voice is {self.voice!r}; expected the name of a voice")


@dataclass(frozen=True)
class Program:
    """How a program is asked to speak.

    Attributes:
        arguments: Of options and words, the program's name left out.
        cancel: Arguments that have it break off what another process of it says; () where ending the process does.
    """

    arguments: Callable[[SpeechOptions, str], Sequence[str]]
    cancel: Sequence[str] = ()


def _espeak(options: SpeechOptions, words: str) -> Sequence[str]:
    voice = ("-v", options.voice) if options.voice else ()
    return (*voice, "-s", str(options.words_per_minute), "--", words)


def _spd_say(options: SpeechOptions, words: str) -> Sequence[str]:
    voice = ("-l", options.voice) if options.voice else ()
    rate = max(-100, min(100, options.words_per_minute - _USUAL_WPM))
    return (*voice, "--rate", str(rate), "--wait", "--", words)


def _say(options: SpeechOptions, words: str) -> Sequence[str]:
    voice = ("-v", options.voice) if options.voice else ()
    return (*voice, "-r", str(options.words_per_minute), words)


PROGRAMS = {
    "espeak-ng": Program(_espeak),
    "espeak": Program(_espeak),
    "spd-say": Program(_spd_say, cancel=("--cancel",)),
    "say": Program(_say),
}
"""In the order in which they are looked for."""


class Speech:
    """Implements `station.operator.voice.Voice`.

    Raises:
        DeviceError: the program is not installed.
    """

    def __init__(self, options: SpeechOptions) -> None:
        self._options = options
        self.program, self._path = _find(options.program)

    def play(self, cue: Cue, hush: Hush) -> None:
        """Speak the words of a cue.

        Raises:
            DeviceError: the program failed, does not come to an end, or cannot be broken off.
        """
        program = PROGRAMS[self.program]
        command = [self._path, *program.arguments(self._options, cue.words)]
        with tempfile.TemporaryFile() as stderr:
            try:
                process = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True
                )
            except OSError as error:
                raise self._cannot_be_run(error) from None
            with process:
                if not _is_over(process, hush):
                    self._break_off(process, program)
                    return
            if process.returncode:
                stderr.seek(0)
                words = stderr.read(1 << 16).decode(errors="replace").split("\n")
                last = next((line.strip() for line in reversed(words) if line.strip()), "without a word")
                raise DeviceError(f"{self.program} ended with exit code {process.returncode}: {last[:200]}")

    def close(self) -> None:
        """Nothing is held."""

    def _break_off(self, process: subprocess.Popen[bytes], program: Program) -> None:
        process.terminate()
        try:
            process.wait(_ENDS_S)
        except subprocess.TimeoutExpired:
            process.kill()
        if program.cancel:
            self._cancel(program.cancel)

    def _cancel(self, arguments: Sequence[str]) -> None:
        quiet = subprocess.DEVNULL
        try:
            subprocess.run(
                [self._path, *arguments], timeout=_ENDS_S, check=False, stdin=quiet, stdout=quiet, stderr=quiet
            )
        except subprocess.TimeoutExpired:
            words = " ".join((self.program, *arguments))
            raise DeviceError(f"`{words}` has not ended within {_ENDS_S:g} s; does its sound service run?") from None
        except OSError as error:
            raise self._cannot_be_run(error) from None

    def _cannot_be_run(self, error: OSError) -> DeviceError:
        return DeviceError(f"{self._path} cannot be run: {error.strerror}; is it still installed?")


def missing() -> str:
    """Return what this machine lacks for speech; "" for nothing."""
    try:
        _find("")
    except DeviceError as error:
        return str(error)
    return ""


def _is_over(process: subprocess.Popen[bytes], hush: Hush) -> bool:
    """Wait for the end of a program; return False when it is to be broken off.

    Raises:
        DeviceError: it takes too long; it was killed.
    """
    left_s = _LONGEST_S
    while process.poll() is None:
        if hush(_LOOK_S):
            return False
        left_s -= _LOOK_S
        if left_s < 0.0:
            process.kill()
            raise DeviceError(f"the speech program has not ended within {_LONGEST_S:g} s; it was killed")
    return True


def _find(wanted: str) -> tuple[str, str]:
    """Return name and path of a speech program."""
    for name in (wanted,) if wanted else PROGRAMS:
        if path := shutil.which(name):
            return name, path
    what = f"no {wanted}" if wanted else f"no program to speak with: none of {', '.join(PROGRAMS)}"
    raise DeviceError(f"{what} on the path; install one (Debian, Ubuntu: apt install espeak-ng; macOS has say)")
