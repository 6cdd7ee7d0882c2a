"""``station episodes success|tag|rename|undo|prune|restore``: looking after a data folder."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.cli import candidates
from station.cli.options import data_option, episode_argument, json_option, task_option
from station.errors import EpisodeError, UsageError
from station.printable import printable

if TYPE_CHECKING:
    from station.episode.reading.listing import EpisodeRow

_SUCCESS = {"yes": True, "no": False, "unknown": None}
_NAMES = {success: name for name, success in _SUCCESS.items()}

by_option = click.option(
    "--by", "by", metavar="NAME", default="", help="Who says so.  [default: operator of your config, else login name]"
)


@click.command("success")
@click.argument("episodes", metavar="EPISODE...", nargs=-1, required=True, shell_complete=candidates.episodes)
@click.argument("success", type=click.Choice([*_SUCCESS]))
@by_option
@data_option
def success(episodes: Sequence[str], success: str, by: str, data: Path | None) -> None:
    """Say of each EPISODE whether the task was done; `station episodes undo` takes it back."""
    from station.episode.storage.edits import set_success

    def say(folder: Path, base: Path, who: str) -> str:
        edit = set_success(folder, base, _SUCCESS[success], who)
        return f"success {success}" + ("" if edit is None else f" (was {_NAMES[edit.before]})")

    _for_each(episodes, data, by, say)


@click.command("tag", context_settings={"ignore_unknown_options": True, "help_option_names": ["--help"]})
@click.argument("words", metavar="EPISODE... [+TAG|-TAG]...", nargs=-1, required=True,
                shell_complete=candidates.episodes)  # fmt: skip
@by_option
@data_option
def tag(words: Sequence[str], by: str, data: Path | None) -> None:
    """Put tags on each EPISODE, and take tags off it: `station episodes tag latest +good -blurred`.

    Without a tag it prints those that are there. `station episodes list --tag good` lists, `station episodes undo`
    takes the last change back.
    """
    from station.episode.storage.edits import change_tags
    from station.episode.storage.manifest_copy import find_manifest

    signs = {sign: [word[1:] for word in words if word.startswith(sign)] for sign in "+-"}
    episodes = [word for word in words if word[0:1] not in signs]
    if not episodes:
        raise UsageError("name an EPISODE, and +TAG or -TAG")

    def say(folder: Path, base: Path, who: str) -> str:
        if any(signs.values()):
            change_tags(folder, base, signs["+"], signs["-"], who)
        return "tags: " + (", ".join(find_manifest(folder).manifest.tags) or "none")

    _for_each(episodes, data, by, say)


@click.command("rename")
@click.argument("episodes", metavar="EPISODE...", nargs=-1, required=True, shell_complete=candidates.episodes)
@click.option("--task", required=True, metavar="NAME", shell_complete=candidates.tasks, help="Its task from now on.")
@by_option
@data_option
def rename(episodes: Sequence[str], task: str, by: str, data: Path | None) -> None:
    """Give each EPISODE another task and move it to the folder of that; its id stays."""
    from station.episode.storage.edits import rename_task

    if not task.strip():
        raise UsageError("--task: expected the name of a task, got nothing")
    _for_each(episodes, data, by, lambda folder, base, who: f"is now {rename_task(folder, base, task, who)}")


@click.command("undo")
@episode_argument
@by_option
@data_option
def undo(episode: str, by: str, data: Path | None) -> None:
    """Undo the last change of success, tags or task of EPISODE; again, the one before."""
    from station.episode.storage.edits import undo as undo_last

    def say(folder: Path, base: Path, who: str) -> str:
        edit, where = undo_last(folder, base, who)
        return f"{edit.what} is {_value(edit.before)} again, not {_value(edit.after)} ({where})"

    _for_each([episode], data, by, say)


def _value(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return _NAMES[value]
    return (", ".join(value) or "none") if isinstance(value, list) else str(value)


def _for_each(episodes: Sequence[str], data: Path | None, by: str, say: Callable[[Path, Path, str], str]) -> None:
    """Change each episode and say in a line what it is now; exit code 1 when one could not be changed."""
    from station.user_config import operator

    who, failed = operator(by), False
    for name in episodes:
        try:
            folder, base = _found(name, data)
            click.echo(printable(f"{folder.name} {say(folder, base, who)}"))
        except EpisodeError as error:
            failed = True
            click.echo(f"station: {printable(str(error))}", err=True)
    raise SystemExit(1 if failed else 0)


def _found(name: str, data: Path | None) -> tuple[Path, Path]:
    """Return the folder of an episode and the data folder that it lies in.

    Raises:
        EpisodeError: there is none, or it lies in a bin, or in no folder of a task.
    """
    from station.episode.storage.folder import BIN, resolve

    path = resolve(name, data)
    folder = (path.parent if path.is_file() else path).absolute()
    base = folder.parent.parent
    if base.name == BIN:
        raise EpisodeError(f"{folder}: lies in the bin; take it back first: station episodes restore {folder.name}")
    return folder, base


@click.command("prune")
@click.argument("episodes", metavar="[EPISODE]...", nargs=-1, shell_complete=candidates.episodes)
@click.option("--verdict", "verdicts", type=click.Choice(("good", "usable", "reject", "unchecked")), multiple=True,
              help="Those of this verdict; may repeat.")  # fmt: skip
@click.option("--discarded", is_flag=True, help="Those that were discarded.")
@click.option("--older-than", "older", metavar="WHEN", default=None,
              help="Those that started more than 12h or 30d ago, or before 2026-11-20.")  # fmt: skip
@task_option
@click.option(
    "--empty-bin", "is_emptying", is_flag=True, help="Delete for good what lies in the bin, and nothing else."
)
@click.option("--dry-run", is_flag=True, help="Show what would be done, and do nothing.")
@click.option("--yes", is_flag=True, help="Empty the bin without asking.")
@by_option
@data_option
@json_option
def prune(
    episodes: Sequence[str], verdicts: Sequence[str], discarded: bool, older: str | None, task: Sequence[str],
    is_emptying: bool, dry_run: bool, yes: bool, by: str, data: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Move episodes into the bin of the data folder: those named, and of them, or of all, those that fit every option.

    Nothing is deleted: `station episodes restore ID` brings one back, `station episodes list --bin` shows them. Room is
    free when `station episodes prune --empty-bin` has deleted them, which asks first. Exit code 1 when one could not be
    moved.
    """
    from station.episode.storage.folder import data_folder

    base = data_folder(data)
    has_filter = bool(episodes or verdicts or discarded or older is not None or task)
    if is_emptying:
        if has_filter:
            raise UsageError("--empty-bin empties all of the bin: give it alone, after the episodes are in the bin")
        _empty(base, is_dry=dry_run, is_asked=yes, as_json=as_json)
        return
    if not has_filter:
        raise UsageError(
            "name EPISODEs, or say which: --verdict reject, --discarded, --older-than 30d, --task NAME; "
            "--dry-run shows what would go"
        )
    rows = wanted_rows(base, episodes, verdicts, older, task, is_discarded=discarded or None)
    _throw_away(rows, base, by, _why(verdicts, older, task, is_discarded=discarded), is_dry=dry_run, as_json=as_json)


def wanted_rows(
    base: Path, episodes: Sequence[str], verdicts: Sequence[str], older: str | None, tasks: Sequence[str], *,
    is_discarded: bool | None,
) -> list[EpisodeRow]:  # fmt: skip
    """Return the rows of the episodes that are meant; of those that are not named, only those that are finished."""
    from station.episode.reading.listing import EpisodeFilter, list_episodes, since

    wanted = EpisodeFilter(
        verdicts=verdicts, is_discarded=is_discarded,
        before=None if older is None else since(older, where="--older-than"),
    )  # fmt: skip
    named = {_found(name, base)[0] for name in episodes}
    if strangers := sorted(folder for folder in named if folder.parent.parent != base.absolute()):
        raise UsageError(f"{strangers[0]}: does not lie in {base.absolute()}; name its data folder with --data")
    rows = [row for row in list_episodes(base, wanted=wanted) if not tasks or row.task in tasks]
    if named:
        return [row for row in rows if Path(row.path).absolute() in named]
    return [row for row in rows if row.state in ("finished", "failed")]


def _why(verdicts: Sequence[str], older: str | None, tasks: Sequence[str], *, is_discarded: bool) -> str:
    """Return in words why episodes are moved into the bin."""
    words = [f"verdict {' or '.join(verdicts)}"] if verdicts else []
    words += ["discarded"] if is_discarded else []
    words += [f"older than {older}"] if older is not None else []
    words += [f"task {' or '.join(tasks)}"] if tasks else []
    return ", ".join(words) or "named"


def _throw_away(
    rows: Sequence[EpisodeRow], base: Path, by: str, why: str, *, is_dry: bool, as_json: bool
) -> None:  # fmt: skip
    from station.episode.storage.bin import expect_at_rest, size_of, throw_away
    from station.episode.storage.edits import note_bin
    from station.user_config import operator

    who, failed = operator(by), False
    moved: list[dict[str, Any]] = []
    for row in rows:
        folder = Path(row.path)
        try:
            size = size_of(folder)
            if is_dry:
                expect_at_rest(folder, base)
            else:
                folder = throw_away(folder, base)
            moved.append({"episode_id": folder.name, "path": str(folder), "bytes": size})
            if not as_json:
                click.echo(
                    printable(f"{folder.name} {size / 1e6:.1f} MB, {row.verdict or 'unchecked'}, task {row.task}")
                )
            if not is_dry:
                note_bin(folder, before="", after=why, by=who)
        except (EpisodeError, OSError) as error:
            failed = True
            click.echo(f"station: {printable(str(error))}", err=True)
    total = _total(moved)
    if as_json:
        click.echo(json.dumps(moved))
    elif not moved and failed:
        pass  # said already, of each
    elif not moved:
        click.echo(f"no episode in {base.absolute()} fits ({why}): nothing to move")
    elif is_dry:
        click.echo(f"{total} would go into the bin ({why})")
    else:
        click.echo(
            f"{total} moved into the bin ({why}); back: station episodes restore ID, "
            "gone for good: station episodes prune --empty-bin"
        )
    raise SystemExit(1 if failed else 0)


def _total(episodes: Sequence[dict[str, Any]]) -> str:
    """Return how many episodes there are and what they need."""
    size = sum(one["bytes"] for one in episodes) / 1e6
    return f"{len(episodes)} episode{'' if len(episodes) == 1 else 's'}, {size:.1f} MB,"


def _empty(base: Path, *, is_dry: bool, is_asked: bool, as_json: bool) -> None:
    from station.episode.storage.bin import bin_folder, clear, delete, in_bin, size_of

    found: list[dict[str, Any]] = [
        {"episode_id": folder.name, "path": str(folder), "bytes": size_of(folder)} for folder in in_bin(base)
    ]
    what = _total(found)
    if not as_json and (is_dry or not is_asked):
        for one in found:
            click.echo(printable(f"{one['episode_id']} {one['bytes'] / 1e6:.1f} MB"))
    if found and not is_dry and not is_asked:
        if not sys.stdin.isatty():
            raise UsageError(f"prune --empty-bin: there is no terminal to ask in; --yes deletes {what} for good")
        if not click.confirm(f"Delete {what} for good?", err=True):
            raise SystemExit(1)
    if not is_dry:
        for one in found:
            delete(Path(one["path"]), base)
        clear(base)
    if as_json:
        click.echo(json.dumps(found))
    elif not found:
        click.echo(f"nothing in {bin_folder(base).absolute()}")
    else:
        click.echo(f"{what} would be deleted" if is_dry else f"{what} deleted")


@click.command("restore")
@click.argument("episodes", metavar="ID...", nargs=-1, required=True, shell_complete=candidates.in_bin)
@by_option
@data_option
def restore(episodes: Sequence[str], by: str, data: Path | None) -> None:
    """Bring episodes back from the bin to where they were."""
    from station.episode.storage.bin import find_in_bin, take_back
    from station.episode.storage.edits import note_bin
    from station.episode.storage.folder import data_folder
    from station.user_config import operator

    base, who, failed = data_folder(data), operator(by), False
    for name in episodes:
        try:
            folder = take_back(find_in_bin(name, base), base)
            click.echo(printable(f"{folder.name} is back: {folder}"))
            note_bin(folder, before="in the bin", after="", by=who)
        except EpisodeError as error:
            failed = True
            click.echo(f"station: {printable(str(error))}", err=True)
    raise SystemExit(1 if failed else 0)


COMMANDS = (success, tag, rename, undo, prune, restore)
"""In the order in which `station episodes --help` lists them."""
