"""Which spacemouse to read, and what to tell whoever has none, two, or one that may not be opened."""

from __future__ import annotations

import importlib
import os
import re
import sys
from dataclasses import dataclass, field
from typing import Any

from adapters.devices.spacemouse.models import MOTION_USAGE, Model, model_of
from station.operator.device import DeviceError

UDEV_RULE = 'KERNEL=="hidraw*", KERNELS=="*:256F:*|*:046D:C62?.*", MODE="0660", GROUP="plugdev", TAG+="uaccess"'
"""By the name of the HID device, alike over USB and Bluetooth; of Logitech's only the 3D mice, no keyboards."""

UDEV_FILE = "/etc/udev/rules.d/70-spacemouse.rules"

_NO_USAGE = (0, 0)  # hidapi over libusb does not look it up
_USB_INTERFACE = re.compile(r"^\d+-[\d.]+:\d+\.\d+$")


@dataclass
class Mouse:
    """One device that is plugged in.

    Attributes:
        model: What it is.
        serial: Its serial number, "" for one without.
        paths: Of its HID interfaces that may send motion.
    """

    model: Model
    serial: str
    paths: list[bytes] = field(default_factory=list)

    def __str__(self) -> str:
        serial = f"serial {self.serial}" if self.serial else "no serial"
        return f"{self.model.name} ({serial}, {', '.join(path.decode(errors='replace') for path in self.paths)})"


def library() -> Any:
    """Return the module of the package ``hidapi``: on Linux the one for hidraw, which takes no driver away.

    Raises:
        DeviceError: it is not installed, or another package has taken its name.
    """
    for name in ("hidraw", "hid") if sys.platform == "linux" else ("hid",):
        try:
            module = importlib.import_module(name)
        except ImportError:
            continue
        if hasattr(module, "device"):
            return module
        raise DeviceError(
            f"the module {name} is not that of the package hidapi but another of the same name; "
            "pip uninstall hid; pip install --force-reinstall hidapi"
        )
    raise DeviceError("a spacemouse needs hidapi, which is not installed; pip install 'teleop-station[spacemouse]'")


def choose(hid: Any, *, serial: str = "", path: str = "") -> Mouse:
    """Return the one spacemouse that is plugged in, or the one of several that was asked for.

    Args:
        hid: The module of the library.
        serial: Its serial number; "" for any.
        path: One of its interfaces, such as ``/dev/hidraw3``; "" for any.

    Raises:
        DeviceError: there is none, none that fits, or more than one.
    """
    mice = found(hid.enumerate(0, 0))
    if not mice:
        raise DeviceError(
            "no spacemouse found; plug one in (`lsusb` lists it as 256f:… or 046d:c6…), wake a wireless one"
        )
    fitting = [mouse for mouse in mice if serial in ("", mouse.serial) and (not path or path.encode() in mouse.paths)]
    listed = "; ".join(str(mouse) for mouse in mice)
    if not fitting:
        wanted = " and ".join(filter(None, [serial and f"serial {serial!r}", path and f"path {path!r}"]))
        raise DeviceError(f"no spacemouse with {wanted}; found: {listed}")
    if len(fitting) > 1:
        raise DeviceError(f"{len(fitting)} spacemice found: {listed}; choose one with serial: or path:")
    return fitting[0]


def plugged_in() -> list[str]:
    """Return each spacemouse that is plugged in, as a person is told.

    Raises:
        DeviceError: there is no library.
    """
    return [str(mouse) for mouse in found(library().enumerate(0, 0))]


def found(interfaces: list[dict[str, Any]]) -> list[Mouse]:
    """Return the spacemice among HID interfaces as hidapi lists them, one entry per interface and usage.

    All interfaces of a receiver are kept, since the mouse that is paired with it decides which of them speaks (issue
    #49 of PySpaceMouse); of other devices those that send motion.
    """
    mice: dict[tuple[str, str, int], Mouse] = {}
    numbers: dict[tuple[str, str, int], set[int]] = {}
    for path, usages, entry in _by_path(interfaces):
        model = model_of(entry["vendor_id"], entry["product_id"], usages[0])
        sends_motion = MOTION_USAGE in usages or usages == [_NO_USAGE]
        if model is None or not (model.is_receiver or sends_motion):
            continue
        serial, number = entry.get("serial_number") or "", entry.get("interface_number", -1)
        place = (model.name, _usb_device(path) or serial, 0)
        while number in numbers.setdefault(place, set()):  # the same interface again: that is another device
            place = (*place[:2], place[2] + 1)
        numbers[place].add(number)
        mice.setdefault(place, Mouse(model, serial)).paths.append(path)
    return list(mice.values())


def _by_path(interfaces: list[dict[str, Any]]) -> list[tuple[bytes, list[tuple[int, int]], dict[str, Any]]]:
    """Return each interface once, with all usages it has, that of motion first."""
    usages: dict[bytes, list[tuple[int, int]]] = {}
    entries: dict[bytes, dict[str, Any]] = {}
    for entry in interfaces:
        usages.setdefault(entry["path"], []).append((entry.get("usage_page", 0), entry.get("usage", 0)))
        entries.setdefault(entry["path"], entry)
    return [
        (path, sorted(usages[path], key=lambda usage: usage != MOTION_USAGE), entry) for path, entry in entries.items()
    ]


def _usb_device(path: bytes) -> str:
    """Return where on the USB bus an interface sits, such as ``1-2``, so that two receivers are told apart."""
    name = os.path.basename(path.decode(errors="replace"))
    parts = os.path.realpath(f"/sys/class/hidraw/{name}/device").split(os.sep)
    return next((part.split(":")[0] for part in parts if _USB_INTERFACE.match(part)), "")


def open_all(hid: Any, mouse: Mouse) -> list[Any]:
    """Open the interfaces of a spacemouse for reads that do not block.

    Raises:
        DeviceError: one of them cannot be opened, with the udev rule that a missing permission asks for.
    """
    opened = []
    try:
        for path in mouse.paths:
            device = hid.device()
            _open(device, path, mouse)
            opened.append(device)
    except DeviceError:
        for device in opened:
            device.close()
        raise
    return opened


def _open(device: Any, path: bytes, mouse: Mouse) -> None:
    try:
        device.open_path(path)
    except OSError as error:
        why = str(device.error() or error)
        if "ermission" not in why and "access" not in why.lower():
            raise DeviceError(f"{mouse}: cannot be opened: {why}") from None
        raise DeviceError(
            f"{mouse}: permission denied; install this udev rule and plug it in again: "
            f"echo '{UDEV_RULE}' | sudo tee {UDEV_FILE} && sudo udevadm control --reload"
        ) from None
    device.set_nonblocking(True)
