"""``station docs``: the pages that ship with the station."""

from __future__ import annotations

import sys

import click

from station import packages
from station.cli import candidates
from station.errors import UnknownName

_NO_PAGE = ("index",)  # the site's list of the others


@click.command("docs")
@click.argument("page", default="", shell_complete=candidates.pages)
def command(page: str) -> None:
    """Print PAGE of the docs of this version; without PAGE, list them."""
    found = {path.stem: path for path in packages.docs().glob("*.md") if path.stem not in _NO_PAGE}
    pages = dict(sorted(found.items()))
    if page:
        name = page.removeprefix("docs/").removesuffix(".md")
        if name not in pages:
            raise UnknownName("page", page, pages)
        text = pages[name].read_text(encoding="utf-8")
        if sys.stdout.isatty():
            click.echo_via_pager(text)
        else:
            click.echo(text, nl=False)
        return
    from station.cli.tables import Column, plain, print_table

    titles = {name: path.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ") for name, path in pages.items()}
    rows = [(plain(name), plain(title)) for name, title in titles.items()]
    print_table([Column("page", "left"), Column("what it tells", "left")], rows)
    click.echo("\nread one: station docs PAGE")
