"""``station devices calibrate gello``: calibrating a leader arm at a terminal."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import click

from adapters.devices.console import Terminal
from adapters.devices.gello import calibration as calibrations
from adapters.devices.gello import ports
from adapters.devices.gello.bus import BUSES, Servos
from adapters.devices.gello.calibrate import SIGNS, Plan, calibrate_port
from adapters.devices.gello.calibration import Arm
from adapters.devices.serial_port import serial_of
from station.errors import UsageError, did_you_mean
from station.operator.device import DeviceError

_USUAL = ", ".join(f"{bus.bauds[0]} of {maker}" for maker, bus in BUSES.items())


@click.command("gello")
@click.option("--port", default="", help="Serial port of the leader.  [default: the only adapter that is plugged in]")
@click.option("--arm", required=True, type=click.Choice(["left", "right"]), help="Which arm of the robot it leads.")
@click.option("--joints", required=True, metavar="NAMES", help="Names of the robot's joints from the base on: a,b,c.")
@click.option(
    "--pose-deg", metavar="NUMBERS", default=None,
    help="Where you will hold the joints, in degrees: 0,-90,90.  [default: all zero]",
)  # fmt: skip
@click.option(
    "--signs", metavar="SIGNS", default=None,
    help=f"How the servos turn: 1,-1,… or {', '.join(SIGNS)}.  [default: found by turning each joint]",
)  # fmt: skip
@click.option("--no-gripper", is_flag=True, help="The leader has no trigger.")
@click.option(
    "--servos", default="dynamixel", show_default=True, type=click.Choice(list(BUSES)), help="Whose servos it has."
)
@click.option(
    "--baud", default=None, type=int,
    help=f"Rate of the servos [bit/s].  [default: {_USUAL}]",
)  # fmt: skip
@click.option(
    "--calibrations", metavar="DIR", default=None, type=click.Path(file_okay=False, path_type=Path),
    help="Folder to keep it in.  [default: ~/.config/station/gello]",
)  # fmt: skip
def command(
    port: str,
    arm: Arm,
    joints: str,
    pose_deg: str | None,
    signs: str | None,
    no_gripper: bool,
    servos: Servos,
    baud: int | None,
    calibrations: Path | None,
) -> None:
    """Find offsets, signs and the gripper's travel of a leader arm, and keep them by its serial number.

    You are asked to turn each joint (unless --signs says how they turn), to hold the leader in a known pose, and to
    let go and pull the trigger. Nothing is kept before the end.
    """
    names = tuple(name.strip() for name in joints.split(","))
    if not all(names) or len(set(names)) < len(names):
        raise UsageError(f"--joints: expected different names such as base,shoulder,elbow, got {joints!r}")
    pose = (0.0,) * len(names) if pose_deg is None else tuple(map(math.radians, _numbers("--pose-deg", pose_deg)))
    plan = Plan(arm, names, pose, None if signs is None else _signs(signs), has_gripper=not no_gripper)
    chosen = port or _only_port(servos)
    if not sys.stdin.isatty():
        raise UsageError("devices calibrate gello: there is no terminal to ask in; it needs somebody at the leader")
    terminal = Terminal()
    _print_replaced(chosen, calibrations, terminal)
    calibrate_port(chosen, plan, terminal, servos=servos, baud=baud, folder=calibrations)


def _only_port(servos: Servos) -> str:
    try:
        return ports.choose((), 1, servos=servos)[0]
    except DeviceError as error:  # it names the settings of a server
        raise DeviceError(f"{error} (here: --port)") from None


def _print_replaced(port: str, folder: Path | None, terminal: Terminal) -> None:
    file = calibrations.file_of(folder or calibrations.default_folder(), serial_of(port))
    if file.exists():
        terminal.show(f"{file} is there and will be replaced at the end")


def _signs(text: str) -> tuple[int, ...]:
    if text in SIGNS:
        return SIGNS[text]
    numbers = _numbers("--signs", text, f" or one of {', '.join(SIGNS)}{did_you_mean(text, SIGNS)}")
    if not set(numbers) <= {1.0, -1.0}:
        raise UsageError(f"--signs: expected 1 or -1 for each joint, got {text!r}")
    return tuple(map(int, numbers))


def _numbers(option: str, text: str, others: str = "") -> tuple[float, ...]:
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        numbers = (math.nan,)
    if not all(map(math.isfinite, numbers)):
        raise UsageError(f"{option}: expected numbers with commas between{others}, got {text!r}")
    return numbers
