"""What a device is to the server that reads it, and to the command line. Knows no device, no robot and no bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from station.errors import StationError
from station.operator.measure import OperatorMeasure
from station.operator.reading import Reading

if TYPE_CHECKING:
    import click


class DeviceError(StationError):
    """A device that is missing, refused, torn out or misconfigured; one line that says what to do."""


@runtime_checkable
class Device(Protocol):
    """A device of an operator, opened by its constructor.

    Opening raises `DeviceError` when it cannot be used. A device that comes and goes by itself (a headset behind a
    service) opens without data, and waits.
    """

    def read(self) -> Reading | None:
        """Return the newest sample, or None when there is none since the last call; never blocks.

        Whatever has queued up is drained, so that an old sample is never given. A device that sends only changes
        returns its present state at every call, for as long as it knows that the device is there.

        Raises:
            DeviceError: the device is gone, and this object will never give a sample again.
        """
        ...

    def why_silent(self) -> str:
        """Return in one line why there may be no data, and what to do; "" when nothing is known.

        Called now and then while there are none; may take a few milliseconds.
        """
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this device: model, serial number, library and its version, calibration."""
        ...

    def close(self) -> None:
        """Release the device; a second call does nothing."""
        ...


@dataclass(frozen=True, kw_only=True)
class DeviceKind:
    """A kind of device as `station devices` shows it; registered under ``station.devices``, imports nothing heavy.

    Attributes:
        name: Of the device, its server and its scripts.
        about: What it is, in a line.
        library: The package that reads it; "" for none.
        extra: The extra of this package that brings the library; "" for none.
        example: A script of its fake.
        plugged_in: Returns each one that can be seen now, as a person is told; raises `DeviceError` where nobody can
            tell: no library, no permission.
        controls: Names of its controls; with ``*`` for any end (``button_*``). Empty where they are not
            known: then a file of buttons may name any.
        buttons: Gestures by action, as in a file of buttons (`station.operator.buttons`): what its buttons ask for
            until a file says otherwise. Empty for a device without any, or whose buttons differ too much.
        play: Plays a script until Ctrl-C (`KeyboardInterrupt`) or the script's end. Takes the file, and the TCP port
            where `port` is one, else None. Raises `station.errors.BadFile` and `DeviceError`.
        port: TCP port on which the fake listens by default; None for a fake that does not.
        calibrate: Returns the verb below `station devices calibrate`, of the device's name; None for a device that
            needs none.
        measure: Returns who measures an operator of what this device shows; None for one that sees no body.
    """

    name: str
    about: str
    library: str
    extra: str
    example: Path
    plugged_in: Callable[[], Sequence[str]]
    play: Callable[[Path, int | None], None]
    controls: Sequence[str] = ()
    buttons: Mapping[str, Any] = field(default_factory=dict)
    port: int | None = None
    calibrate: Callable[[], click.Command] | None = None
    measure: Callable[[], OperatorMeasure] | None = None
