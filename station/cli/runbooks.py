"""``station runbooks``: what `station up` can run without a file of one's own, and a beginning for such a file."""

from __future__ import annotations

import json
from pathlib import Path

import click

from station.cli import candidates
from station.cli.options import NamedPath, Verbs, json_option
from station.errors import UsageError
from station.supervision import runbook as runbooks


@click.group("runbooks", cls=Verbs)
def command() -> None:
    """List the runbooks that ship, show one, or copy one to change it."""


@command.command("list")
@json_option
def listing(as_json: bool) -> None:
    """List the runbooks that `station up NAME` runs: robot, and what each is for."""
    from station.cli.tables import Column, plain, print_table

    found = {name: runbooks.describe(path) for name, path in runbooks.shipped().items()}
    if as_json:
        rows = [{"name": name, "robot": robot, "about": about} for name, (robot, about) in found.items()]
        click.echo(json.dumps(rows))
        return
    columns = [Column("runbook", "left"), Column("robot", "left"), Column("what it is for", "left")]
    print_table(columns, [(plain(name), plain(robot), plain(about)) for name, (robot, about) in found.items()])
    click.echo(
        "\nrun one: station up RUNBOOK; its steps: station up RUNBOOK --dry-run; "
        "one of your own: station runbooks copy RUNBOOK"
    )


@command.command("show")
@click.argument("runbook", shell_complete=candidates.runbooks)
def show(runbook: str) -> None:
    """Print the file of RUNBOOK, with what it says about how to run it."""
    click.echo(_text(runbooks.find(runbook)), nl=False)


@command.command("copy")
@click.argument("runbook", shell_complete=candidates.shipped_runbooks)
@click.argument("file", required=False, type=NamedPath(path_type=Path))
def copy(runbook: str, file: Path | None) -> None:
    """Write a copy of RUNBOOK that you can change to FILE, in the current folder if none is named."""
    source = runbooks.find(runbook)
    target = file or Path(source.name)
    if target.is_dir():
        target /= source.name
    text = _text(source)
    try:
        with target.open("x", encoding="utf-8") as opened:
            opened.write(text)
    except FileExistsError:
        raise UsageError(f"{target}: is there already, and is left as it is; name another FILE") from None
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}") from None
    click.echo(f"wrote {target}; run it with: station up {target if target.suffix else f'./{target}'}")


def _text(path: Path) -> str:
    runbooks.describe(path)  # says in a line what is wrong with a file that is none
    return path.read_text(encoding="utf-8")
