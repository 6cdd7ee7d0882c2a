"""Which serial ports are leaders, and what their adapters are called."""

from __future__ import annotations

import os
from pathlib import Path

from adapters.devices.gello.bus import Servos
from adapters.devices.serial_port import BY_ID, serial_of
from station.operator.device import DeviceError

_ADAPTERS: dict[Servos, tuple[str, str]] = {
    "dynamixel": ("U2D2", "usb-FTDI_USB__-__Serial_Converter_*"),
    "feetech": ("servo adapter", "usb-1a86_USB_Single_Serial_*"),  # a CH343, as on the boards of SO-101
}
"""What the usual adapters are called, and their ports by id."""

_LATENCY = "/sys/bus/usb-serial/devices/{tty}/latency_timer"
LATENCY_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


def choose(wanted: tuple[str, ...], count: int, folder: Path = BY_ID, servos: Servos = "dynamixel") -> list[str]:
    """Return the ports of the leaders: those that were asked for, or all adapters that are plugged in.

    Args:
        wanted: Names of ports; none for any.
        count: How many leaders there are to be.
        folder: Where ports appear by serial number.
        servos: Whose servos they have, which says which adapters are looked for.

    Raises:
        DeviceError: there are fewer, or more than that and none were asked for.
    """
    if wanted:
        if len(wanted) != count:
            raise DeviceError(f"{len(wanted)} ports for {count} leaders; name one each with ports:")
        return list(wanted)
    adapter, pattern = _ADAPTERS[servos]
    found = sorted(str(path) for path in folder.glob(pattern))
    if not found:
        raise DeviceError(
            f"no leader found: no {pattern} in {folder}; "
            f"plug its {adapter} in, or name another port with ports: [/dev/tty…]"
        )
    if len(found) != count:
        listed = ", ".join(found)
        raise DeviceError(f"{len(found)} adapters found, {count} wanted: {listed}; choose with ports: or leaders:")
    return found


def plugged_in(folder: Path = BY_ID) -> list[str]:
    """Return a line for each adapter that may belong to a leader: its serial number and its port."""
    found = sorted(path for _, pattern in _ADAPTERS.values() for path in folder.glob(pattern))
    return [f"adapter {serial_of(str(path), folder)} at {path}" for path in found]


def latency_advice(port: str) -> str:
    """Return what to do about an adapter that holds bytes back for 16 ms, as FTDI's do by default; "" for nothing."""
    tty = os.path.basename(os.path.realpath(port))
    try:
        latency_ms = int(Path(_LATENCY.format(tty=tty)).read_text())
    except (OSError, ValueError):
        return ""  # no FTDI adapter, or no Linux
    if latency_ms <= 1:
        return ""
    return (
        f"{port} holds bytes back for {latency_ms} ms, which keeps a leader near {1000 // (latency_ms + 1)} Hz; set 1 "
        f"with this udev rule: echo '{LATENCY_RULE}' | sudo tee /etc/udev/rules.d/71-ftdi-latency.rules"
    )
