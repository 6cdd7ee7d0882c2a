"""The cues server: an operator in a headset hears what happens.

It reads the bus and moves nothing, so it runs anywhere: beside the station, or on the operator's own computer. What is
said of which event stands in one table (`station.operator.phrases`), which a file of the lab may change; how it is said
is a voice's business (`adapters.cues`): tones, speech, a sound file. Cues never hold anything up: each voice says them
in a thread of its own, the newest matters, urgent ones interrupt, what comes too late is dropped and counted.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec

from station import config as configs
from station import registry
from station.clock import Clock
from station.config import to_plain
from station.errors import StationError
from station.life.server import Life, ServerKind
from station.operator import phrases
from station.operator.cues import OLD_S, CueQueue, Speaker
from station.operator.phrases import Phrases
from station.operator.station_monitor import StationMonitor
from station.operator.voice import VoiceKind

_PERIOD_S = 0.02


class CuesConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the cues server.

    Attributes:
        voices: Registered names of how it is said, `station devices voices` lists them; several say all of it.
        options: Of the voices, by name.
        phrases: YAML file that changes what is said of an event; None for the table as it is.
        old_s: What has waited for longer is not said any more [s].
    """

    voices: Annotated[tuple[str, ...], registry.named("voice")] = ("tones",)
    options: dict[str, dict[str, Any]] = {}
    phrases: Path | None = None
    old_s: float = OLD_S

    def __post_init__(self) -> None:
        if not self.voices or len(set(self.voices)) < len(self.voices):
            raise ValueError(f"voices: expected different names, got {', '.join(self.voices) or 'none'}")
        for name in self.voices:
            registry.expect("voice", name)
        if odd := sorted(set(self.options) - set(self.voices)):
            raise ValueError(f"options: {', '.join(odd)} is none of the voices ({', '.join(self.voices)})")
        if not 0.5 <= self.old_s <= 60.0:
            raise ValueError(f"old_s is {self.old_s:g}; expected 0.5 to 60 s")
        for name in self.voices:
            self.typed_options(name)

    @property
    def option_types(self) -> dict[str, type[msgspec.Struct]]:
        """Types of the settings that are mappings, by name."""
        kinds: dict[str, VoiceKind] = {name: registry.find("voice", name) for name in self.voices}
        return {f"options.{name}": kind.options for name, kind in kinds.items()}

    def typed_options(self, voice: str) -> Any:
        """Return the options of a voice as its type has them.

        Raises:
            ValueError: they are none of its options; the message names the field.
        """
        kind: VoiceKind = registry.find("voice", voice)
        return configs.build_options(kind.options, self.options.get(voice, {}), where=f"options of the voice {voice}")


def _expect_voices(config: CuesConfig) -> None:
    for name in config.voices:
        kind: VoiceKind = registry.find("voice", name)
        if why := kind.missing():
            raise StationError(f"voice {name}: {why}")


def main(config: CuesConfig, life: Life) -> int:
    """Let it be heard what happens until asked to stop; return the exit code."""
    table = Phrases() if config.phrases is None else phrases.load(config.phrases)
    with contextlib.ExitStack() as stack:
        speakers = {name: _speaker(config, name, life.clock) for name in config.voices}
        for speaker in speakers.values():
            stack.callback(speaker.close)
        told = sum(bool(phrase.words) for phrase in table.table.values())
        life.configured({"server": life.name, "role": KIND.role, "phrases": told, "config": to_plain(config)})
        if not life.ready():
            return 0
        monitor = stack.enter_context(StationMonitor(life.bus, life.name))
        _run(life, monitor, table, speakers)
    return 0


KIND = ServerKind(
    name="cues",
    role="observer",
    summary="lets an operator hear what happens: engaged, refused, lost, recording, stops",
    config=CuesConfig,
    main=main,
    expect=_expect_voices,
)


def _speaker(config: CuesConfig, name: str, clock: Clock) -> Speaker:
    kind: VoiceKind = registry.find("voice", name)
    return Speaker(kind.make(config.typed_options(name)), CueQueue(old_s=config.old_s), clock)


def _run(life: Life, monitor: StationMonitor, table: Phrases, speakers: Mapping[str, Speaker]) -> None:
    while not life.clock.wait(life.stop_event, _PERIOD_S):
        for event in monitor.poll():
            if (cue := table.cue(event)) is not None:
                for speaker in speakers.values():
                    speaker.play(cue)
        for name, speaker in speakers.items():
            if why_not := speaker.pop_error():
                life.event("cue-not-said", severity="warning", voice=name, reason=why_not)
        life.report(
            said=sum(speaker.said for speaker in speakers.values()),
            dropped=sum(speaker.dropped for speaker in speakers.values()),
            broken_off=sum(speaker.broken_off for speaker in speakers.values()),
        )
