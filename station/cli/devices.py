"""``station devices``: what an operator drives with: what is there, fakes of it, buttons, calibration."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import click
import msgspec
from rich.markup import escape

from station import registry
from station.cli.options import Verbs, json_option
from station.cli.tables import Column, plain, print_table
from station.errors import UsageError
from station.operator.device import DeviceError, DeviceKind


@click.group("devices", cls=Verbs)
def command() -> None:
    """Find operators' devices, play fakes of them, show their buttons, calibrate."""


class _Found(msgspec.Struct, kw_only=True):
    """A device as `list` shows it.

    Attributes:
        version: Of the library; None where that is not installed.
        plugged_in: What can be seen now.
        problem: Why nobody can tell; "" for none.
    """

    device: str
    about: str
    library: str
    version: str | None
    extra: str
    plugged_in: Sequence[str]
    problem: str = ""

    @property
    def is_missing(self) -> bool:
        return bool(self.library) and self.version is None


@command.command("list")
@json_option
def listing(as_json: bool) -> None:
    """List the kinds of devices, and what is plugged in.

    For each: the library that reads it, what can be seen of it now, and what it gives.
    """
    found = [_look(_kind(name)) for name in registry.names("device")]
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(found)))
        return
    columns = [Column(title, "left") for title in ("device", "library", "plugged in", "what it gives")]
    print_table(columns, [_row(each) for each in found])
    for each in found:
        if each.problem and not each.is_missing:
            click.echo(f"\n{each.device}: {each.problem}")
    if extras := [each.extra for each in found if each.is_missing]:
        click.echo(f"\nto install what is missing: pip install 'teleop-station[{','.join(extras)}]'")
    click.echo("\nto try one without hardware: station devices fake DEVICE")


def _kind(name: str) -> DeviceKind:
    kind: DeviceKind = registry.find("device", name)
    return kind


def _look(kind: DeviceKind) -> _Found:
    seen, problem = list[str](), ""
    try:
        seen += kind.plugged_in()
    except DeviceError as error:
        problem = str(error)
    try:
        version = importlib.metadata.version(kind.library) if kind.library else None
    except importlib.metadata.PackageNotFoundError:
        version = None
    return _Found(
        device=kind.name, about=kind.about, library=kind.library, version=version, extra=kind.extra, plugged_in=seen,
        problem=problem,
    )  # fmt: skip


def _row(found: _Found) -> Sequence[str]:
    if found.is_missing:
        library = f"[yellow]no {escape(found.library)}[/]"
    else:
        library = escape(f"{found.library} {found.version}") if found.library else "–"
    if found.plugged_in:
        seen = f"[green]{', '.join(map(plain, found.plugged_in))}[/]"
    else:
        seen = "[yellow]cannot tell[/]" if found.problem else "[dim]–[/]"
    return found.device, library, seen, found.about


@command.command("fake")
@click.argument("device")
@click.option(
    "--play", metavar="FILE", default=None, type=click.Path(path_type=Path),
    help="Script of what the operator does.  [default: an example that comes with the station]",
)  # fmt: skip
@click.option(
    "--port", default=None, type=click.IntRange(0, 65535), help="TCP port, for a device that has one; 0: any."
)
def fake(device: str, play: Path | None, port: int | None) -> None:
    """Play a fake of DEVICE in this terminal.

    It plays until Ctrl-C. Nothing but the hardware is missing: the library that reads the device is the real one.
    """
    kind = _kind(device)
    if port is not None and kind.port is None:
        raise UsageError(f"devices fake {device}: takes no --port; it has no TCP port")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        kind.play(kind.example if play is None else play, kind.port if port is None else port)
    if sys.stdout.isatty():
        click.echo()  # a terminal has shown ^C


class _Calibrations(Verbs):
    """The verbs of the devices that are calibrated."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for name in registry.names("device") if _kind(name).calibrate is not None]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        calibrate = _kind(cmd_name).calibrate if cmd_name in registry.names("device") else None
        return None if calibrate is None else calibrate()


@command.group("calibrate", cls=_Calibrations)
def calibrate() -> None:
    """Calibrate a device, with whoever holds it."""


@command.command("buttons")
@click.argument("device", default="")
@click.option(
    "--map", "changes", metavar="FILE", default=None, type=click.Path(path_type=Path),
    help="YAML file that changes what the buttons of DEVICE mean, as the teleop server's setting `buttons`.",
)  # fmt: skip
@json_option
def buttons(device: str, changes: Path | None, as_json: bool) -> None:
    """Show what buttons ask for, of DEVICE or of all."""
    from station.operator import buttons as maps

    if changes is not None and not device:
        raise UsageError("devices buttons --map: name the device whose buttons the file changes")
    names = [_kind(device).name] if device else [name for name in registry.names("device") if maps.DEFAULTS.get(name)]
    found = [maps.button_map(name) if changes is None else maps.load(name, changes) for name in names]
    if as_json:
        plain_maps = {
            each.device: {action: [str(one) for one in each.gestures.get(action, ())] for action in maps.ACTIONS}
            for each in found
        }
        click.echo(json.dumps(plain_maps))
        return
    for index, each in enumerate(found):
        if index:
            click.echo()
        columns = [Column(title, "left") for title in (each.device, "ask with", "what is asked")]
        print_table(columns, [tuple(map(plain, row)) for row in each.table()])
