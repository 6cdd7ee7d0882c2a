"""``station import``: recordings of other recorders become episodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from station import registry
from station.cli import candidates
from station.cli.options import NamedPath, data_option, jobs_option, json_option
from station.errors import BadFile, UnknownName
from station.printable import printable

if TYPE_CHECKING:
    from station.export.jobs import Attempt
    from station.foreign.kind import ForeignKind
    from station.foreign.take_in import ImportJob, ImportResult

_TOLD = 20


def _list(ctx: click.Context, _option: click.Parameter, is_asked: bool) -> None:
    if is_asked and not ctx.resilient_parsing:
        for name in registry.names("foreign"):
            click.echo(f"{name}  {registry.find('foreign', name).summary}")
        ctx.exit()


@click.command("import")
@click.argument("format_", metavar="FORMAT", shell_complete=candidates.registered("foreign"))
@click.argument(
    "folders", metavar="FOLDERS...", nargs=-1, required=True, type=NamedPath(file_okay=False, path_type=Path)
)
@data_option
@click.option("--task", default="", metavar="NAME", help="Name of their task.  [default: the recorder's own]")
@click.option("--instruction", default="", metavar="TEXT", help="The task in words.")
@jobs_option
@click.option("--list", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="List the formats.")
@json_option
def command(
    format_: str, folders: Sequence[Path], data: Path | None, task: str, instruction: str, jobs: int, as_json: bool
) -> None:
    """Make episodes of recordings of FORMAT (`--list` names them); those that were imported before stay as they are.

    \b
    station import twist2 TWIST2/data/cabinet --instruction "open the cabinet"

    FOLDERS are recordings, or folders of them. Bytes stay as they were recorded; what nobody knows of them is told in
    the manifest, and no time is made up. Exit code 1 when one could not be imported; all others are.
    """
    if format_ not in (known := registry.names("foreign")):
        raise UnknownName("format of recordings", format_, known)
    kind: ForeignKind = registry.find("foreign", format_)
    attempts = _import(_orders(kind, folders, data, task, instruction), jobs, is_quiet=as_json)
    failed = [each for each in attempts if each.result is None]
    for each in failed[:_TOLD]:
        click.echo(f"failed: {printable(each.error)}", err=True)
    if failed[_TOLD:]:
        click.echo(f"failed: {len(failed) - _TOLD} more", err=True)
    if as_json:
        click.echo(msgspec.json.encode([_plain(each) for each in attempts]))
    else:
        _show([each.result for each in attempts if each.result is not None], len(failed))
    raise SystemExit(1 if failed else 0)


def _orders(
    kind: ForeignKind, folders: Sequence[Path], data: Path | None, task: str, instruction: str
) -> list[ImportJob]:  # fmt: skip
    from station.episode.storage.folder import data_folder
    from station.foreign.take_in import ImportJob

    base = data_folder(data).absolute()
    found: dict[Path, None] = {}
    for folder in folders:
        if not folder.is_dir():
            raise BadFile(f"{folder}: no such folder")
        recordings = kind.find(folder)
        if not recordings:
            raise BadFile(f"{folder}: no recording of {kind.name} in it; expected {kind.summary}")
        found.update(dict.fromkeys(path.absolute() for path in recordings))
    return [
        ImportJob(format=kind.name, path=str(path), data=str(base), task=task, instruction=instruction)
        for path in found
    ]


def _import(orders: Sequence[ImportJob], jobs: int, *, is_quiet: bool) -> list[Attempt[ImportJob, ImportResult]]:
    from station.export.jobs import map_episodes
    from station.export.progress import progress
    from station.foreign.take_in import import_recording

    with progress(len(orders), "import", is_quiet=is_quiet) as tell:
        return map_episodes(import_recording, orders, jobs=jobs, on_done=lambda each: tell(is_lost=each.result is None))


def _plain(attempt: Attempt[ImportJob, ImportResult]) -> dict[str, Any]:
    result = None if attempt.result is None else msgspec.to_builtins(attempt.result)
    return {"recording": attempt.item.path, "episode": result, "error": attempt.error}


def _show(taken: Sequence[ImportResult], failed: int) -> None:
    for each in taken:
        times = "" if each.are_times_measured else ", times not measured"
        what = f"{each.messages} values in {each.seconds:.1f} s{times}, {each.size_bytes / 1e6:.1f} MB"
        click.echo(f"{Path(each.path).name}: {what if each.is_new else 'there already'}")
        for line in each.odd if each.is_new else ():
            click.echo(f"  ! {printable(line)}")
    counts = [f"{sum(each.is_new for each in taken)} imported"]
    if old := sum(not each.is_new for each in taken):
        counts.append(f"{old} there already")
    if failed:
        counts.append(f"{failed} failed")
    click.echo(", ".join(counts) + "; `station episodes show` tells what is not known of each")
