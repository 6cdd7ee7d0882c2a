"""What a kind of device is to the station: a server by its name, buttons, a fake, and what the command line shows."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from station import libraries
from station.clock import Clock
from station.config import to_plain
from station.errors import ConfigError
from station.operator.device import Source
from station.operator.measure import OperatorMeasure

if TYPE_CHECKING:
    import click

    from station.life.server import Life, ServerKind


class DeviceConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of a device's server; a kind adds its own.

    Attributes:
        rate_hz: Looks at the device per second [Hz]; each takes in all that has queued up.
        fake: Script of a fake, played in place of a real device; it begins when the server is active, and goes on after
            a restart.
    """

    rate_hz: float = 100.0
    fake: Path | None = None

    def __post_init__(self) -> None:
        if not 10.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 500 Hz")


@dataclass(frozen=True, kw_only=True)
class DeviceKind:
    """A kind of device; registered under ``station.devices``, imports nothing heavy.

    Attributes:
        name: Of the device, its server and its scripts.
        about: What it is, in a line.
        source: A function under `contextlib.contextmanager` that yields where its server has it from. Takes the
            settings, the server's clock, and the time [s] at which the script of a fake is to begin. Raises
            `station.errors.BadFile` (of a script) and `station.operator.device.DeviceError`.
        plugged_in: Returns each one that can be seen now, as a person is told; raises `DeviceError` where nobody can
            tell: no library, no permission.
        config: Type of its server's settings.
        library: The package that reads it; "" for none.
        extra: The extra of the package that brings the library; "" for none.
        example: A script of its fake; None for a device without a fake.
        controls: Names of its controls; with ``*`` for any end (``button_*``). Empty where they are not
            known: then a file of buttons may name any.
        buttons: Gestures by action, as in a file of buttons (`station.operator.buttons`): what its buttons ask for
            until a file says otherwise. Empty for a device without any, or whose buttons differ too much.
        play: Plays a script for another process until Ctrl-C (`KeyboardInterrupt`) or the script's end. Takes the file,
            and the TCP port where `port` is one, else None. None for a fake that its own process alone can see:
            then its readings are shown.
        port: TCP port on which the fake listens by default; None for a fake that does not.
        calibrate: Returns the verb below `station devices calibrate`, of the device's name; None for a device that
            needs none.
        measure: Returns who measures an operator of what this device shows; None for one that sees no body.
    """

    name: str
    about: str
    source: Callable[[Any, Clock, float], AbstractContextManager[Source]]
    plugged_in: Callable[[], Sequence[str]]
    config: type[DeviceConfig] = DeviceConfig
    library: str = ""
    extra: str = ""
    example: Path | None = None
    controls: Sequence[str] = ()
    buttons: Mapping[str, Any] = field(default_factory=dict)
    play: Callable[[Path, int | None], None] | None = None
    port: int | None = None
    calibrate: Callable[[], click.Command] | None = None
    measure: Callable[[], OperatorMeasure] | None = None

    @property
    def server(self) -> ServerKind:
        """Its server, under its name."""
        from station.life.server import ServerKind

        return ServerKind(
            name=self.name, role="sensor", summary=f"reads {self.about}", config=self.config, main=self._serve,
            expect=lambda _: libraries.expect(f"device {self.name}", self.library, self.extra),
        )  # fmt: skip

    def _serve(self, config: DeviceConfig, life: Life) -> int:
        """Publish what the device gives until asked to stop; return the exit code."""
        from station.operator import script_time
        from station.operator.serve import serve_device

        if config.fake is not None and self.example is None:
            raise ConfigError(f"{self.name}.fake is {config.fake}; this device has no fake")
        start_s = script_time.now_s(life) if config.fake is not None else 0.0
        with self.source(config, life.clock, start_s) as source:
            begin = None if source.begin is None else functools.partial(script_time.begin, source.begin, start_s)
            return serve_device(life, source, rate_hz=config.rate_hz, config=to_plain(config), on_active=begin)
