"""``station record``: ask the recorder for something."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from station import config
from station.cli import candidates
from station.cli.options import Verbs, bus_option, json_option
from station.printable import printable

if TYPE_CHECKING:
    from station.api.live import Record
    from station.episode.storage.request import RecordAnswer


@click.group("record", cls=Verbs)
def command() -> None:
    """Start, stop, mark or discard a recording."""


@command.command("start")
@click.option("--task", default="", shell_complete=candidates.tasks,
              help="Name of the task; episodes of a task share a folder.")  # fmt: skip
@click.option("--instruction", default="", help="Language instruction.")
@click.option("--operator", default="", help="Who operates.  [default: of your config, else your login name]")
@click.option("--planned", metavar="DURATION", default=None, help="Refuse when the disk cannot hold this long (2min).")
@click.option("--leave-out", multiple=True, metavar="KEY",
              help="Do without a key, or all that begin so, such as policy_obs; can be given again.")  # fmt: skip
@bus_option
@json_option
def start(
    task: str, instruction: str, operator: str, planned: str | None, leave_out: tuple[str, ...], bus: str | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Begin an episode."""
    planned_s = None if planned is None else config.seconds(planned, where="--planned")
    _ask(bus, as_json, lambda record: record.start(task, instruction=instruction, operator=operator,
                                                   planned_s=planned_s, leave_out=leave_out), "recording")  # fmt: skip


@command.command("stop")
@click.option("--success/--failure", default=None, help="Whether the task was done.")
@bus_option
@json_option
def stop(success: bool | None, bus: str | None, as_json: bool) -> None:
    """End the episode and count what is in it."""
    _ask(bus, as_json, lambda record: record.stop(success=success), "finished")


@command.command("mark")
@click.argument("label", default="mark")
@bus_option
@json_option
def mark(label: str, bus: str | None, as_json: bool) -> None:
    """Put a mark into the episode, here and now."""
    _ask(bus, as_json, lambda record: record.mark(label), "marked")


@command.command("discard")
@click.option("--reason", "label", default="", help="Why.")
@bus_option
@json_option
def discard(label: str, bus: str | None, as_json: bool) -> None:
    """End the episode and mark it as not to be used; nothing is deleted."""
    _ask(bus, as_json, lambda record: record.discard(label), "discarded")


def _ask(bus: str | None, as_json: bool, act: Callable[[Record], RecordAnswer], done: str) -> None:
    import msgspec

    from station.api.live import Station

    with Station(bus, name="record") as station:
        answer = act(station.record)
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(answer)))
        return
    click.echo(printable(f"{done} {answer.episode_id}  {answer.path}"))
    for name, value in answer.summary.items():
        if value is not None:
            shown = f"{value:.1f}" if isinstance(value, float) else str(value)
            click.echo(printable(f"  {name:16} {shown}"))
