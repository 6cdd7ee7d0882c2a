"""``station record``: ask the recorder for something."""

from __future__ import annotations

import getpass
import json
from typing import Any

import click

from station import config
from station.cli import candidates
from station.cli.options import Verbs, address_of, bus_option, json_option
from station.printable import printable

_PATIENCE_S = 20.0  # a stop waits for the disk
_DOUBT_S = 2.0  # where no recorder is heard: one on a machine with a wrong clock may be there all the same
_DONE = {"start": "recording", "stop": "finished", "mark": "marked", "discard": "discarded"}


@click.group("record", cls=Verbs)
def command() -> None:
    """Start, stop, mark or discard a recording."""


@command.command("start")
@click.option("--task", default="", shell_complete=candidates.tasks,
              help="Name of the task; episodes of a task share a folder.")  # fmt: skip
@click.option("--instruction", default="", help="Language instruction.")
@click.option("--operator", default="", help="Who operates.  [default: your login name]")
@click.option("--planned", metavar="DURATION", default=None, help="Refuse when the disk cannot hold this long (2min).")
@bus_option
@json_option
def start(
    task: str, instruction: str, operator: str, planned: str | None, bus: str | None, as_json: bool
) -> None:  # fmt: skip
    """Begin an episode."""
    person = {"id": operator or getpass.getuser()}
    planned_s = None if planned is None else config.seconds(planned, where="--planned")
    _ask("start", bus, as_json, task=task, instruction=instruction, operator=person, planned_s=planned_s)


@command.command("stop")
@click.option("--success/--failure", default=None, help="Whether the task was done.")
@bus_option
@json_option
def stop(success: bool | None, bus: str | None, as_json: bool) -> None:
    """End the episode and count what is in it."""
    _ask("stop", bus, as_json, success=success)


@command.command("mark")
@click.argument("label", default="mark")
@bus_option
@json_option
def mark(label: str, bus: str | None, as_json: bool) -> None:
    """Put a mark into the episode, here and now."""
    _ask("mark", bus, as_json, label=label)


@command.command("discard")
@click.option("--reason", "label", default="", help="Why.")
@bus_option
@json_option
def discard(label: str, bus: str | None, as_json: bool) -> None:
    """End the episode and mark it as not to be used; nothing is deleted."""
    _ask("discard", bus, as_json, label=label)


def _ask(action: Any, bus: str | None, as_json: bool, **fields: Any) -> None:
    import msgspec

    from station.bus.client import Bus
    from station.episode.recorder import remote
    from station.life.server import read_health

    with Bus(address_of(bus), name="record", timeout_s=1.0) as line:
        is_there = any(health.role == "recorder" and health.is_alive for health in read_health(line))
        ack = remote.ask(line, action, timeout_s=_PATIENCE_S if is_there else _DOUBT_S, **fields)
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(ack)))
        return
    click.echo(printable(f"{_DONE[action]} {ack.episode_id}  {ack.path}"))
    for name, value in ack.summary.items():
        if value is not None:
            shown = f"{value:.1f}" if isinstance(value, float) else str(value)
            click.echo(printable(f"  {name:16} {shown}"))
