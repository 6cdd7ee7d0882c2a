"""What a device is to the server that reads it. Knows no device and no robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from station.bus.address import BusAddress
from station.errors import StationError
from station.operator.sample import OperatorSample

LENT_TERMINAL = "STATION_TERMINAL"
"""Environment variable: name of the pseudo terminal to which ``station up`` sends keys; unset or "" for none."""


class DeviceError(StationError):
    """A device that is missing, refused, torn out or misconfigured; one line that says what to do."""


@runtime_checkable
class Device(Protocol):
    """A device of an operator, opened by its constructor.

    Opening raises `DeviceError` when it cannot be used. A device that comes and goes by itself (a headset behind a
    service) opens without data, and waits.
    """

    def read(self) -> OperatorSample | None:
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
class Source:
    """Where a server has its device from.

    Attributes:
        open: Opens the device; called again after it was lost. Raises `DeviceError`.
        begin: Lets the script of a fake begin; called once, when the server is active. None for a real device.
        also: Makes further values, written with every tick, of the newest sample; of an empty one while the device is
            lost, so that no button stays pressed.
        beside: What runs beside it while the server is active, of the bus's address and the server's name: of a device
            that shows its operator pictures and tells what happens. None for one that does not.
        numbers: What the server tells of the device once a second, in its heartbeat.
    """

    open: Callable[[], Device]
    begin: Callable[[], object] | None = None
    also: Callable[[OperatorSample], Mapping[str, bytes]] | None = None
    beside: Callable[[BusAddress, str], AbstractContextManager[object]] | None = None
    numbers: Callable[[], Mapping[str, Any]] | None = None
