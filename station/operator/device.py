"""What a device is to the server that reads it. Knows no device, no robot and no bus."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

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
