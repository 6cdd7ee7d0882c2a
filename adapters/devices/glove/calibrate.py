"""Calibrating a glove with the person who wears it: a flat hand, then a fist."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from adapters.devices import calibration_file
from adapters.devices.console import Console
from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove.calibration import MOST_NUMBERS, Calibration, SensorCalibration, Side
from adapters.devices.glove.device import BOOT_S
from adapters.devices.glove.lines import Line, LineReader, Protocol
from adapters.devices.glove.ports import BAUD, GlovePort
from adapters.devices.glove.sensors import PRESETS, UNUSED
from adapters.devices.serial_port import serial_of
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.protocols import Floats

FLAT = "Hold the hand flat, fingers spread and open, thumb out; then Enter"
FIST = "Make a fist, the thumb over the fingers, and hold it; then Enter"

LEAST_SHARE = 0.05
"""Of the range in which all sensors were seen: one that moves less has not been moved."""

LEAST_COUNTS = 10.0
"""And of counts, for a sensor that writes whole numbers."""

_NOISE = 3.0  # times what a sensor moves while the hand is held still
_MEASURE_S = 0.5
_FEWEST = 5  # lines of a measurement


@dataclass(frozen=True)
class Plan:
    """What is to be calibrated.

    Attributes:
        side: The hand that wears the glove.
        protocol: How it writes.
        sensors: A name for each number of its line, `adapters.devices.glove.sensors.UNUSED` for one that is no sensor;
            empty for a preset by how many there are.
    """

    side: Side
    protocol: Protocol = "numbers"
    sensors: tuple[str, ...] = ()


class _Held(NamedTuple):
    """What every number of the line showed while the hand was held still, shape (numbers,) each [counts]."""

    median: Floats
    noise: Floats
    is_whole: bool


def calibrate_port(
    port: str, plan: Plan, console: Console, *, baud: int = BAUD, folder: Path | None = None, clock: Clock = SYSTEM
) -> Path:
    """Calibrate the glove on a serial port and keep what was found; return the file.

    Args:
        port: Name of the port.
        plan: What is to be calibrated.
        console: The person who wears it.
        baud: Rate of the port [bit/s].
        folder: Where calibrations are kept; None for that of the user's settings.
        clock: Of the process.

    Raises:
        DeviceError: the port cannot be opened or is torn out, no good line comes, or the lines do not fit the plan.
        BadFile: the calibration cannot be written.
    """
    opened = GlovePort(port, baud)
    try:
        return calibrate(opened, serial_of(port), plan, console, folder or calibrations.default_folder(), clock)
    finally:
        opened.close()


def calibrate(port: GlovePort, serial: str, plan: Plan, console: Console, folder: Path, clock: Clock) -> Path:
    """Calibrate the glove on an open port and keep what was found; return the file.

    Raises:
        DeviceError: the port is torn out, no good line comes, or the lines do not fit the plan.
        BadFile: the calibration cannot be written.
    """
    count = Counter(map(len, _lines(port, plan.protocol, None, clock))).most_common(1)[0][0]
    names = _names(plan, count)
    used = [(number, name) for number, name in enumerate(names) if name != UNUSED]
    console.show(f"a line has {count} numbers: {', '.join(names)}")
    while True:
        console.ask(FLAT)
        flat = _held(port, plan.protocol, count, clock)
        console.ask(FIST)
        fist = _held(port, plan.protocol, count, clock)
        told = _unmoved(used, flat, fist)
        if not told:
            break
        for line in told:
            console.show(line)
        console.show("once more: the whole hand, or leave out what is no sensor with - in --sensors")
    for number, name in used:
        console.show(f"{name}: {flat.median[number]:g} open, {fist.median[number]:g} closed")
    made = Calibration(
        serial=serial, side=plan.side, date=calibration_file.today(), protocol=plan.protocol, numbers=count,
        sensors=tuple(
            SensorCalibration(
                name=name, number=number, open=float(flat.median[number]), closed=float(fist.median[number])
            )
            for number, name in used
        ),
    )  # fmt: skip
    file = calibrations.save(folder, made)
    console.show(f"glove {serial} is calibrated for the {plan.side} hand: {file}")
    return file


def _names(plan: Plan, count: int) -> tuple[str, ...]:
    """Return a name for each number of a line."""
    if count > MOST_NUMBERS:
        raise DeviceError(f"a line has {count} numbers; expected at most {MOST_NUMBERS}")
    names = plan.sensors or PRESETS.get(count, ())
    if not names:
        known = " and ".join(map(str, PRESETS))
        raise DeviceError(
            f"a line has {count} numbers, and only {known} have names by themselves; name each with "
            f"--sensors thumb,index,…, {UNUSED} for one that is no sensor"
        )
    if len(names) != count:
        raise DeviceError(f"a line has {count} numbers, but --sensors names {len(names)}: {','.join(names)}")
    return names


def _unmoved(used: Sequence[tuple[int, str]], flat: _Held, fist: _Held) -> list[str]:
    """Return a line for each sensor that has not moved enough from the flat hand to the fist."""
    travel = np.abs(fist.median - flat.median)
    seen = [float(held.median[number]) for held in (flat, fist) for number, _ in used]
    floor = max(LEAST_SHARE * (max(seen) - min(seen)), LEAST_COUNTS if flat.is_whole and fist.is_whole else 0.0)
    told = []
    for number, name in used:
        least = max(floor, _NOISE * float(max(flat.noise[number], fist.noise[number])))
        if travel[number] < least or travel[number] == 0.0:
            told.append(
                f"{name}: number {number + 1} of the line has moved by {travel[number]:g} only, expected {least:.4g} "
                "at least; see to its magnet or lever and to its wire, and hold still while it is measured"
            )
    return told


def _held(port: GlovePort, protocol: Protocol, count: int, clock: Clock) -> _Held:
    lines = np.array(_lines(port, protocol, count, clock))
    low, high = np.percentile(lines, (10, 90), axis=0)
    return _Held(np.median(lines, axis=0), np.asarray(high - low), bool((lines == np.rint(lines)).all()))


def _lines(port: GlovePort, protocol: Protocol, count: int | None, clock: Clock) -> list[Line]:
    """Return the good lines of half a second, from the first one that comes from now on."""
    port.drop()
    reader, found = LineReader(protocol, count), list[Line]()
    end_s = clock.monotonic_s() + BOOT_S
    while clock.monotonic_s() < end_s:
        lines = reader.feed(port.read())
        if lines and not found:
            end_s = clock.monotonic_s() + _MEASURE_S
        found += lines
    if len(found) >= _FEWEST:
        return found
    if reader.last_bad:
        came = f"the last bad line is '{reader.last_bad}', expected {reader.expected}; see to --baud and --protocol"
    elif found:
        came = f"{len(found)} lines in {_MEASURE_S:g} s, expected {_FEWEST} at least; let it write more often"
    elif reader.received:
        came = f"no whole line, expected {reader.expected}, and the end of a line; see to --baud"
    else:
        came = "nothing comes; see to its power and cable"
    raise DeviceError(f"{port.port}: no glove writes here at {port.baud} baud: {came}")
