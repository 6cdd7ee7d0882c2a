"""A fake PC service in the foreground."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import click

from adapters.devices.fakes.pico import script as scripts
from adapters.devices.fakes.pico.play import play
from adapters.devices.fakes.pico.service import DEFAULT_PORT, PicoService
from adapters.devices.fakes.punctual import be_punctual
from station.stop_signals import set_on_signals

_LOOK_S = 0.1


def run(
    file: Path,
    port: int,
    *,
    start_s: float = 0.0,
    on_listening: Callable[[PicoService, threading.Event, threading.Event], None],
    on_begin: Callable[[], None] = lambda: None,
) -> None:
    """Play a script until SIGINT or SIGTERM.

    Args:
        file: The script.
        port: TCP port on 127.0.0.1; 0 takes a free one.
        start_s: Time of the script to begin at [s].
        on_listening: Called with the service, and events that let the script begin and end all.
        on_begin: Called when the script begins: with the first client.

    Raises:
        BadFile: the script cannot be read.
        DeviceError: the port is in use, or there is no grpcio.
    """
    stop, go = threading.Event(), threading.Event()
    set_on_signals(stop)
    be_punctual()
    script = scripts.load(file)
    with PicoService(port) as service:
        on_listening(service, go, stop)
        while not stop.is_set() and not (go.wait(_LOOK_S) and service.wait_for_listener(_LOOK_S)):
            pass
        if not stop.is_set():
            on_begin()
        play(script, service, stop.is_set, start_s=start_s)


def run_for_person(file: Path, port: int) -> None:
    """Play a script until Ctrl-C and say what goes on; raises as `run`."""

    def announce(service: PicoService, go: threading.Event, _stop: threading.Event) -> None:
        setting = "" if service.port == DEFAULT_PORT else f" with --set pico.port={service.port}"
        click.echo(
            f"a fake headset at 127.0.0.1:{service.port} waits for a pico server{setting}; Ctrl-C takes it away",
            err=True,
        )
        go.set()

    def announce_begin() -> None:
        click.echo(f"a server is there: {file} begins", err=True)

    run(file, port, on_listening=announce, on_begin=announce_begin)
