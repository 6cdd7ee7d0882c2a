"""``station check``: measure an episode from its file, and judge it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
import msgspec

from station.cli.options import NamedPath, data_option, episode_argument, json_option
from station.errors import EpisodeError, StationError
from station.printable import printable

_SOON_S = 2.0


def _print_rules(context: click.Context, _option: click.Parameter, is_wanted: bool) -> None:
    """Print the rules that ship with us, to be edited, and leave."""
    if is_wanted and not context.resilient_parsing:
        from station.episode.quality.rule_file import SHIPPED

        click.echo(SHIPPED.read_text(encoding="utf-8"), nl=False)
        context.exit()


class _NotCheckedError(StationError):
    """The episode cannot be read: another exit code than that of one which is to be rejected."""

    exit_code = 2


@click.command("check")
@episode_argument
@click.option("--rules", metavar="FILE", default=None, type=NamedPath(dir_okay=False, path_type=Path),
              help="Judge by these rules.  [default: those of $XDG_CONFIG_HOME/station/, else shipped]")  # fmt: skip
@click.option("--print-rules", is_flag=True, is_eager=True, expose_value=False, callback=_print_rules,
              help="Print the rules that ship, every limit explained, and leave.")  # fmt: skip
@click.option("--all", "is_whole", is_flag=True, help="Show the streams of the station's own too.")
@click.option("--audit/--no-audit", "is_audited", default=None,
              help="Have policy and gate run again too, and reject what differs (`station audit`).  "
              "[default: of episodes up to 60 s whose policy is on this machine]")  # fmt: skip
@click.option("--no-write", is_flag=True, help="Leave the manifest as it is.")
@data_option
@json_option
def command(
    episode: str, rules: Path | None, is_whole: bool, is_audited: bool | None, no_write: bool, data: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Check EPISODE (a path, an id, the beginning of one, or `latest`).

    Exit code 1 when it is to be rejected, 2 when it could not be checked.
    """
    from station.cli.quality import print_quality
    from station.episode.quality import rule_file
    from station.episode.quality.check import check, write_measured
    from station.episode.reading.reader import open_episode
    from station.episode.replaying.in_short import LONGEST_S, audit_in_short

    book, audit = rule_file.of_user() if rules is None else rule_file.load(rules), None
    try:
        reader = open_episode(episode, data)
        if is_audited is not False:
            audit = audit_in_short(reader, longest_s=None if is_audited else LONGEST_S)
        with _progress(reader.manifest.timing.duration_s) as tell:
            quality = check(reader, book, tell, audit=audit)
    except EpisodeError as error:
        raise _NotCheckedError(str(error)) from None
    if as_json:
        click.echo(msgspec.json.encode(quality))
    else:
        print_quality(quality, is_whole=is_whole)
    if quality.is_finished and not no_write:
        try:
            write_measured(reader.folder, quality)
        except EpisodeError as error:
            click.echo(
                f"station: {printable(str(error))}; the verdict is not kept there (--no-write asks for none)", err=True
            )
    raise SystemExit(1 if quality.verdict == "reject" else 0)


@contextmanager
def _progress(seconds: float | None) -> Iterator[Callable[[float], None]]:
    """Show how far a check of an episode of some seconds is, on stderr, where that is a terminal and it takes 2 s.

    None, or 0, is an episode of which nobody has said how long it is.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("checking"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    shown = Progress(*columns, console=console, transient=True)
    task, begun_s = shown.add_task("", total=seconds or None), time.monotonic()

    def tell(read_s: float) -> None:
        if console.is_terminal and time.monotonic() - begun_s > _SOON_S:
            shown.start()  # once more does nothing
            shown.update(task, completed=read_s)

    try:
        yield tell
    finally:
        if console.is_terminal:
            shown.stop()
