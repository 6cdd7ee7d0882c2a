"""``station motions``: what can be played, and whether a file of yours can."""

from __future__ import annotations

import inspect
import json
import logging
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Literal

import click
import msgspec

from station import registry
from station.cli.options import json_option
from station.errors import StationError
from station.printable import printable


class _Row(msgspec.Struct, frozen=True, kw_only=True):
    """A motion.

    Attributes:
        motion: Its reference.
        format: How it is kept.
        seconds, fps, frames: Length [s], rate [Hz] and number of the frames that are played.
        note: What is done to it before it is played, "" for nothing.
        problem: Why it cannot be played, "" where it can.
    """

    motion: str
    format: str = ""
    seconds: float | None = None
    fps: float | None = None
    frames: int | None = None
    note: str = ""
    problem: str = ""


@click.command("motions")
@click.argument("motions", nargs=-1)
@click.option("--holes", type=click.Choice(("refuse", "bridge")), default="refuse", show_default=True,
              help="What is done with bad frames between good ones.")  # fmt: skip
@click.option("--formats", "are_formats", is_flag=True, help="Say what each kind of motion file holds.")
@json_option
def command(motions: Sequence[str], holes: Literal["refuse", "bridge"], are_formats: bool, as_json: bool) -> None:
    """List the motions of this machine; or read MOTIONS (files, or patterns such as 'twist2:motions/*.pkl') as the
    motion server does, and say what is played of them. Exit code 1 where one cannot be played.
    """
    from station.assets import inventory

    if are_formats:
        _print_formats(as_json=as_json)
        return
    logging.getLogger("adapters").setLevel(logging.ERROR)  # what was trimmed stands in the table
    named = [reference for motion in motions for reference in inventory.motions_named(motion)]
    rows = [_read(name, holes) for name in named] if motions else _known()
    if as_json:
        click.echo(json.dumps(msgspec.to_builtins(rows)))
    else:
        _print(rows)
        if not motions:
            click.echo("\nplay one: station demo --set motion.motion=MOTION; of your own: station motions --formats")
    raise SystemExit(1 if any(row.problem for row in rows) else 0)


def _known() -> list[_Row]:
    """Return what needs no file, read, and the files that are here, unread."""
    from station.assets import inventory

    files = [item for item in inventory.inventory() if item.where != "not here"]
    kept = [_Row(motion=item.reference, format=item.path.suffix[1:])
            for item in files if _is_listed(item.path.suffix[1:].lower())]  # fmt: skip
    return [_read(name, "refuse") for name in inventory.motions()] + kept


@cache
def _is_listed(suffix: str) -> bool:
    """Whether any file of a suffix is listed as a motion, by what its reader says."""
    return suffix in registry.names("motion") and getattr(registry.find("motion", suffix), "is_listed", True)


def _read(reference: str, holes: str) -> _Row:
    try:
        motion = registry.find("loader", "motion")(reference, holes=holes)
    except StationError as error:
        return _Row(motion=reference, problem=str(error))
    facts: Mapping[str, Any] = motion.facts()
    return _Row(
        motion=reference, format=str(facts.get("format", "")), seconds=round(motion.duration_s, 3),
        fps=round(motion.fps, 3), frames=round(motion.duration_s * motion.fps) + 1, note=_note(facts),
    )  # fmt: skip


def _note(facts: Mapping[str, Any]) -> str:
    """Return what is done to the frames of a file, as the facts for a manifest have it."""
    trimmed, bridged = facts.get("trimmed") or {}, facts.get("bridged") or ()
    filled, beyond = facts.get("joints_filled_with_zero") or (), facts.get("beyond_range") or ()
    found = [f"{_count(count, 'frame')} trimmed at the {end}" for end, count in trimmed.items() if count]
    found += [f"{_count(len(bridged), 'hole')} bridged"] * bool(bridged)
    found += [f"not in the file, held at 0: {', '.join(filled)}"] * bool(filled)
    return "; ".join([*found, *map(str, beyond)])


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _print(rows: Sequence[_Row]) -> None:
    from station.cli.tables import Column, plain, print_table

    columns = [Column("motion", "left"), Column("format", "left"), *map(Column, ("length", "rate", "frames"))]
    playable = [
        (plain(row.motion), plain(row.format), "" if row.seconds is None else f"{row.seconds:.1f} s",
         "" if row.fps is None else f"{row.fps:g} Hz", str(row.frames or ""))
        for row in rows if not row.problem
    ]  # fmt: skip
    if playable:
        print_table(columns, playable)
    for row in rows:
        if row.problem or row.note:
            click.echo(printable(row.problem or f"{row.motion}: {row.note}"))


def _print_formats(*, as_json: bool) -> None:
    found = {}
    for name in registry.names("motion"):
        reader = registry.find("motion", name)
        found[f".{name}"] = inspect.cleandoc(sys.modules[reader.__module__].__doc__ or "")
    if as_json:
        click.echo(json.dumps(found))
        return
    for suffix, words in found.items():
        click.echo(f"{suffix}\n" + "\n".join(f"  {printable(line)}".rstrip() for line in words.splitlines()) + "\n")
