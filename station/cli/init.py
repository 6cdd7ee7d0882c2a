"""``station init``: a folder to work in."""

from __future__ import annotations

from pathlib import Path

import click

from station.cli import candidates
from station.cli.demo import RUNBOOK
from station.cli.options import NamedPath
from station.errors import UsageError

_DATA = "data"  # where episodes go by default, seen from the folder that one is in


@click.command("init")
@click.argument("folder", type=NamedPath(file_okay=False, path_type=Path))
@click.argument("runbook", default=RUNBOOK, shell_complete=candidates.runbooks)
def command(folder: Path, runbook: str) -> None:
    """Make FOLDER to work in: a copy of RUNBOOK and the rules of `station check` to change, and a place for episodes.

    RUNBOOK is one that ships (`station runbooks list`) or a file of yours; the demo's if none is named. What is there
    already stays as it is.
    """
    from station.episode.quality import rule_file
    from station.supervision import runbook as runbooks

    source = runbooks.find(runbook)
    runbooks.describe(source)  # says in a line what is wrong with a file that is none
    book, rules = folder / source.name, folder / "quality.yaml"
    texts = {book: source.read_text(encoding="utf-8"), rules: rule_file.SHIPPED.read_text(encoding="utf-8")}
    if found := [path for path in texts if path.exists()]:
        raise UsageError(f"{found[0]}: is there already, and is left as it is; name another FOLDER")
    try:
        (folder / _DATA).mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{error.filename}: cannot be written: {error.strerror}") from None
    for path, what in ((book, "what happens, in order"), (rules, "what makes an episode good"),
                       (folder / _DATA, "where episodes go")):  # fmt: skip
        click.echo(f"{path}  {what}")
    click.echo(
        f"\nnext:\n  cd {folder}\n  station up ./{book.name} --dry-run    what will happen\n"
        f"  station up ./{book.name} --record     do it, and record it\n"
        f"  station check latest --rules {rules.name}"
    )
