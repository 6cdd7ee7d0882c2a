"""``station assets``: upstream data on this machine."""

from __future__ import annotations

import json
from pathlib import Path

import click

from station import assets
from station.cli.options import Verbs, json_option
from station.errors import AssetMissing, UnknownName


@click.group("assets", cls=Verbs)
def command() -> None:
    """Find upstream data: policies, robot models, motions."""


@command.command("where")
@click.argument("reference", default="")
def where(reference: str) -> None:
    """Print the folder of upstream data, or the file that REFERENCE (such as twist2:motions/x.pkl) names."""
    if reference:
        click.echo(assets.resolve(reference))
        return
    click.echo(_root())


@command.command("list")
@click.argument("collection", default="")
@json_option
def listing(collection: str, as_json: bool) -> None:
    """List what there is, as references that every verb takes."""
    base = _root()
    known = sorted(folder.name for folder in base.iterdir() if folder.is_dir())
    if collection and collection not in known:
        raise UnknownName("collection", collection, known)
    found = sorted(p for p in (base / collection).rglob("*") if p.is_file() and p.suffix != ".STL")
    references = [f"{p.relative_to(base).parts[0]}:{'/'.join(p.relative_to(base).parts[1:])}" for p in found]
    if as_json:
        click.echo(json.dumps(references))
        return
    for reference in references:
        click.echo(reference)


def _root() -> Path:
    base = assets.root()
    if base is None or not base.is_dir():
        problem = "is not set" if base is None else f"names {base}, which is not a folder"
        raise AssetMissing(
            f"${assets.ENVIRONMENT_VARIABLE} {problem}; set it to the folder with upstream data "
            "(docs/assets.md says what belongs there)"
        )
    return base
