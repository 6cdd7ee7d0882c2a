"""``station report``: episodes as one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from station.cli import candidates
from station.cli.options import NamedPath, data_option, task_option
from station.errors import UsageError
from station.printable import printable

if TYPE_CHECKING:
    from station.report.gather import Episode


@click.command("report")
@click.argument("episodes", metavar="[EPISODE]...", nargs=-1, shell_complete=candidates.episodes)
@click.option("--out", metavar="FILE.html", required=True, type=NamedPath(dir_okay=False, path_type=Path),
              help="The file; replaced when it is there.")  # fmt: skip
@task_option
@click.option("--rules", metavar="FILE", default=None, type=NamedPath(dir_okay=False, path_type=Path),
              help="Judge every episode anew by these rules; manifests stay as they are.")  # fmt: skip
@click.option("--draw", "pictured", metavar="N", type=click.IntRange(min=0), default=None,
              help="Draw at most N episodes that are not named, the bad ones first.  [default: 40]")  # fmt: skip
@data_option
def command(
    episodes: tuple[str, ...],
    out: Path,
    task: tuple[str, ...],
    rules: Path | None,
    pictured: int | None,
    data: Path | None,
) -> None:
    """Make a page of EPISODEs (ids, paths, patterns), or of all in a data folder: verdicts, times, pictures, columns.

    \b
    station report latest --out report.html              one episode
    station report --task walk --out walk.html           all of a task

    The page is one file that fetches nothing and runs nothing. What was not checked yet is measured now.
    """
    from station.episode.quality import rule_file
    from station.export.progress import progress
    from station.export.select import sources
    from station.report import make
    from station.report.gather import gather

    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: expected a file that ends in .html")
    book = rule_file.of_user() if rules is None else rule_file.load(rules)
    folders = [Path(source.folder) for source in sources(episodes, data, tasks=task)]
    with progress(len(folders), "measuring") as measured:
        found, unread = gather(folders, book, named=bool(episodes), is_judged_anew=rules is not None, tell=measured)
    most = make.PICTURED if pictured is None else pictured
    with progress(len(found), "drawing") as drawing:
        drawn = make.write(out, found, unread, title=_title(found), pictured=most, tell=drawing)
    for one in unread:
        click.echo(f"station: {printable(one.problem)}", err=True)
    left_out = f", {drawn} of them drawn" if drawn < len(found) else ""
    count = f"{len(found)} episode{'s' if len(found) != 1 else ''}{left_out}"
    click.echo(f"saved {out}: {count}, {out.stat().st_size / 1e6:.1f} MB")
    raise SystemExit(1 if unread else 0)


def _title(found: list[Episode]) -> str:
    if len(found) == 1:
        return f"Episode {found[0].name}"
    tasks = sorted({episode.manifest.task.name for episode in found})
    return f"Task {tasks[0]}" if len(tasks) == 1 else f"{len(found)} episodes of {len(tasks)} tasks"
