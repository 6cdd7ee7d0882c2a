"""``station devices``: what an operator drives with: what is there, fakes of it, buttons, calibration."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import click
import msgspec
from rich.markup import escape

from station import config, libraries, registry
from station.camera.source import CameraError, CameraKind
from station.cli import calibrate_operator, candidates
from station.cli.options import NamedPath, Verbs, json_option, set_option
from station.cli.tables import Column, plain, print_table
from station.clock import SYSTEM
from station.errors import StationError, UsageError
from station.operator.device import Device, DeviceError
from station.operator.device_kind import DeviceKind
from station.operator.sample import OperatorSample
from station.operator.voice import Cue, VoiceKind
from station.printable import printable
from station.stop_signals import set_on_signals

_WORDS = "recording take 7"
_PERIOD_S = 0.02


@click.group("devices", cls=Verbs)
def command() -> None:
    """Find operators' devices, play fakes of them, show their buttons, calibrate, and hear voices."""


class _Found(msgspec.Struct, kw_only=True):
    """A device, or a source of pictures, as `list` shows it.

    Attributes:
        role: ``device`` or ``camera``.
        version: Of the library; None where that is not installed.
        plugged_in: What can be seen now.
        problem: Why that cannot be told; "" for none.
    """

    device: str
    role: Literal["device", "camera"]
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
    """List the kinds of devices and cameras, and what is plugged in.

    For each: the library that reads it, what can be seen of it now, and what it gives.
    """
    found = [_inspect(name) for name in registry.names("device")]
    found += [_inspect_camera(registry.find("camera", name)) for name in registry.names("camera")]
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(found)))
        return
    for index, (role, title) in enumerate((("device", "device"), ("camera", "camera source"))):
        if index:
            click.echo()
        columns = [Column(name, "left") for name in (title, "library", "plugged in", "what it gives")]
        print_table(columns, [_row(each) for each in found if each.role == role])
    for each in found:
        if each.problem and not each.is_missing:
            click.echo(f"\n{each.device}: {each.problem}")
    if extras := dict.fromkeys(each.extra for each in found if each.is_missing):
        click.echo(f"\nto install what is missing: pip install 'teleop-station[{','.join(extras)}]'")
    click.echo("\nto try a device without hardware: station devices fake DEVICE")
    click.echo("to see what a camera gives: station serve camera --name head --set source=SOURCE")


def _kind(name: str) -> DeviceKind:
    kind: DeviceKind = registry.find("device", name)
    if kind.name != name:
        raise StationError(f"device {name!r} calls itself {kind.name!r}; its entry point has to have the same name")
    return kind


def _inspect(name: str) -> _Found:
    """Search for a device; one whose package is broken is listed with that, and the others all the same."""
    seen, problem = list[str](), ""
    try:
        kind = _kind(name)
    except StationError as error:
        return _Found(device=name, role="device", about="", library="", version=None, extra="", plugged_in=(),
                      problem=str(error))  # fmt: skip
    try:
        seen += kind.plugged_in()
    except (DeviceError, OSError, ImportError) as error:
        problem = str(error)
    return _Found(
        device=kind.name, role="device", about=kind.about, library=kind.library, extra=kind.extra,
        version=libraries.version(kind.library), plugged_in=seen, problem=problem,
    )  # fmt: skip


def _loadable() -> Iterator[DeviceKind]:
    """Yield the devices whose packages are not broken; `station devices list` tells of the others."""
    for name in registry.names("device"):
        with contextlib.suppress(StationError):
            yield _kind(name)


def _inspect_camera(kind: CameraKind) -> _Found:
    seen, problem = list[str](), ""
    try:
        seen += kind.plugged_in() if kind.plugged_in is not None else []
    except CameraError as error:
        problem = str(error)
    return _Found(
        device=kind.name, role="camera", about=kind.about, library=kind.library, extra=kind.extra,
        version=libraries.version(kind.library), plugged_in=seen, problem=problem,
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
@click.argument("device", shell_complete=candidates.registered("device"))
@click.option(
    "--play", metavar="FILE", default=None, type=NamedPath(path_type=Path),
    help="Script of what the operator does, a file, or builtin:DEVICE/NAME.json of a device of ours "
    "(`station assets list builtin`).  [default: the device's example]",
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
    if kind.example is None:
        raise UsageError(f"devices fake {device}: this device has no fake")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        file = kind.example if play is None else play
        if kind.play is None:
            _print_readings(kind, file)
        else:
            kind.play(file, kind.port if port is None else port)
    if sys.stdout.isatty():
        click.echo()  # a terminal has shown ^C


class _Calibrations(Verbs):
    """The verbs of the devices that are calibrated."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [kind.name for kind in _loadable() if (kind.calibrate or kind.measure) is not None]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in registry.names("device"):
            return None
        kind = _kind(cmd_name)
        if kind.calibrate is not None:
            return kind.calibrate()
        return calibrate_operator.verb(kind.name, kind.measure()) if kind.measure is not None else None


@command.group("calibrate", cls=_Calibrations)
def calibrate() -> None:
    """Calibrate a device, or measure the operator who wears it."""


@command.command("voices")
@click.argument("voice", default="", shell_complete=candidates.registered("voice"))
@click.option("--words", default=None, help=f"What VOICE is to say.  [default: {_WORDS}]")
@set_option("key=value")
@json_option
def voices(voice: str, words: str | None, sets: tuple[str, ...], as_json: bool) -> None:
    """List the voices of the cues server and what each lacks here; or hear VOICE.

    An operator in a headset hears what happens: `station serve cues --set 'voices: [speech]'`.
    """
    if voice:
        _try_voice(registry.find("voice", voice), words or _WORDS, sets)
        return
    if sets or words is not None:
        raise UsageError(f"{'--set' if sets else '--words'}: of which voice? `station devices voices VOICE …`")
    kinds: list[VoiceKind] = [registry.find("voice", name) for name in registry.names("voice")]
    found = [{"voice": kind.name, "about": kind.about, "missing": kind.missing()} for kind in kinds]
    if as_json:
        click.echo(json.dumps(found))
        return
    columns = [Column(title, "left") for title in ("voice", "here", "what it gives")]
    print_table(columns, [_voice_row(each) for each in found])
    for each in found:
        if each["missing"]:
            click.echo(f"\n{each['voice']}: {each['missing']}")
    click.echo(
        "\nto hear one: station devices voices VOICE; to hear a station: station serve cues --set voices=[VOICE]"
    )


def _voice_row(found: dict[str, str]) -> Sequence[str]:
    return found["voice"], "[yellow]no[/]" if found["missing"] else "[green]yes[/]", found["about"]


def _try_voice(kind: VoiceKind, words: str, sets: tuple[str, ...]) -> None:
    """Play a cue, as the cues server would."""
    from station import config

    options = config.build(kind.options, config.overrides(sets, servers=None).get("", {}), where=f"voice {kind.name}")
    made = kind.make(options)
    try:
        made.play(Cue(words=words, tune="begin"), threading.Event().wait)
    finally:
        made.close()
    chosen = ", ".join(f"{name} {value}" for name, value in config.to_plain(options).items() if value != "")
    click.echo(printable(f"{kind.name} gave {words!r}" + f"; {chosen}" * bool(chosen)))


@command.command("buttons")
@click.argument("device", default="", shell_complete=candidates.registered("device"))
@click.option(
    "--map", "changes", metavar="FILE", default=None, type=NamedPath(path_type=Path),
    help="YAML file that changes what the buttons of DEVICE mean, as the teleop server's setting `buttons`.",
)  # fmt: skip
@json_option
def buttons(device: str, changes: Path | None, as_json: bool) -> None:
    """Show what buttons ask for, of DEVICE or of all."""
    from station.operator import buttons as maps

    if changes is not None and not device:
        raise UsageError("devices buttons --map: name the device whose buttons the file changes")
    names = [_kind(device).name] if device else [kind.name for kind in _loadable() if kind.buttons]
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


def _print_readings(kind: DeviceKind, file: Path) -> None:
    """Play a script and print the device's readings as they change, until Ctrl-C or the end of the device.

    Raises:
        BadFile: the script cannot be read.
        DeviceError: the device cannot be opened.
    """
    settings = config.build(kind.config, {"fake": str(file)}, where=f"devices fake {kind.name}")
    with kind.source(settings, SYSTEM, 0.0) as source:
        device = source.open()
        click.echo(
            f"what a station makes of it; `station up` plays it with --set {kind.name}.fake={file}, "
            f"`station serve {kind.name}` with --set fake={file}",
            err=True,
        )
        if source.begin is not None:
            source.begin()
        _show(device)


def _show(device: Device) -> None:
    # An exception that an interrupt raises within a function that a library calls, as fakes have them, is lost.
    asked = threading.Event()
    set_on_signals(asked)
    began_s, last = time.monotonic(), ""
    try:
        while not asked.wait(_PERIOD_S):
            reading = device.read()
            line = _line(reading) if reading is not None else last
            if line != last:
                click.echo(f"{time.monotonic() - began_s:8.2f} s  {line}")
                last = line
    except DeviceError as error:
        click.echo(f"{time.monotonic() - began_s:8.2f} s  {error}")
    finally:
        device.close()


def _line(reading: OperatorSample) -> str:
    parts = [f"{name}={value:.3g}" for name, value in reading.controls.items() if value]
    for name, vector in (("twist", reading.twist), ("joints", reading.joints)):
        if vector is not None:
            parts.append(f"{name}=" + " ".join(f"{number:+.2f}" for number in vector))
    return "  ".join(parts) or "at rest"
