"""The voices as they are registered; what is heavy is imported when one is made."""

from __future__ import annotations

from adapters.cues import speech, tones, wav
from station.operator.voice import VoiceKind

TONES = VoiceKind(
    name="tones",
    about="a short tune for each cue, through the sound card",
    options=tones.TonesOptions,
    missing=tones.missing,
    make=tones.Tones,
)
SPEECH = VoiceKind(
    name="speech",
    about="the words of each cue, by a program of the system",
    options=speech.SpeechOptions,
    missing=speech.missing,
    make=speech.Speech,
)
WAV = VoiceKind(
    name="wav",
    about="a sound file of what was said when, and its words",
    options=wav.WavOptions,
    missing=lambda: "",
    make=wav.Wav,
)
