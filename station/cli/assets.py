"""``station assets``: files that the station uses: where they are, and how they come to this machine."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click
import msgspec
from rich.markup import escape

from station import assets
from station.cli.options import Verbs, json_option
from station.cli.tables import Column, print_table
from station.errors import AssetMissing, UsageError

if TYPE_CHECKING:
    from station.assets.fetch import FetchRequest, WantedFile
    from station.assets.inventory import Item

_COLOURS = {"not here": "dim", "built in": "cyan"}


@click.group("assets", cls=Verbs)
def command() -> None:
    """Find and fetch policies, robot models and motions."""


@command.command("where")
@click.argument("reference", default="")
def where(reference: str) -> None:
    """Print the file that REFERENCE (such as twist2:motions/x.pkl) names, or the folders that are looked in."""
    if reference:
        click.echo(assets.resolve(reference))
        return
    base = assets.root()
    unset = f"(${assets.ENVIRONMENT_VARIABLE} is not set)"
    problem = "" if base is None or base.is_dir() else "  (is not a folder)"
    click.echo(f"environment  {unset if base is None else base}{problem}")
    click.echo(f"cache        {assets.cache()}")


@command.command("list")
@click.argument("collection", default="")
@click.option(
    "--verify", is_flag=True, help="Compare whole files with their pinned hashes; exit code 1 when one differs."
)
@json_option
def listing(collection: str, verify: bool, as_json: bool) -> None:
    """List every known file, of one COLLECTION or of all: where it is found, its size and its licence."""
    from station.assets import inventory

    items = inventory.inventory(collection, verify=verify)
    motions = [name for name in inventory.motions() if not collection or name.startswith(f"{collection}:")]
    if as_json:
        click.echo(json.dumps({"files": msgspec.to_builtins(items, enc_hook=str), "motions": motions}))
    else:
        _print(items, motions)
    raise SystemExit(1 if verify and any(item.problem for item in items) else 0)


@command.command("fetch")
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@click.option("--yes", is_flag=True, help="Download without asking.")
@click.option("--dry-run", is_flag=True, help="Show what would be downloaded, and from where.")
def fetch(names: Sequence[str], yes: bool, dry_run: bool) -> None:
    """Download pinned files into the user's cache; `station assets list` shows what there is.

    NAME stands in the last column of that list; the name of a collection stands for all that it offers. Revision,
    addresses, sizes, hashes and licence are shown before anything is downloaded, and only what has its pinned hash
    is kept.
    """
    from station.assets import fetch as fetching

    orders = fetching.orders(names)
    for order in orders:
        if order.missing:
            _show(order, err=not dry_run)
        else:
            more = f" and {len(order.wants) - 1} more" if order.wants[1:] else ""
            click.echo(f"{order.bundle.name}: already there, {order.wants[-1].here}{more}")
    if dry_run:
        return
    if missing := [want for order in orders for want in order.missing]:
        if not yes:
            _ask()
        _download(missing)
    for order in orders:
        if order.missing:
            click.echo(f"{order.bundle.name}: fetched, {_count(order.missing)} into {order.folder}")
        _print_shadowed(order)


def _show(order: FetchRequest, *, err: bool) -> None:
    size = _size(sum(want.file.size_bytes for want in order.missing))
    lines = [
        f"{order.bundle.name}: {order.bundle.about}",
        f"  from      {order.upstream.repository} at {order.upstream.revision}",
        f"  licence   {order.bundle.licence}",
        f"  download  {size}, {len(order.missing)} of {_count(order.wants)}",
        f"  into      {order.folder}",
    ]
    for want in order.missing:
        file = want.file
        lines += [f"    {file.path}  {file.size_bytes} bytes  sha256 {file.sha256}", f"      {want.url}"]
    click.echo("\n".join(lines), err=err)


def _ask() -> None:
    if not sys.stdin.isatty():
        raise UsageError("assets fetch: there is no terminal to ask in; say --yes to download what is shown above")
    if not click.confirm("Download?", err=True):
        raise AssetMissing("nothing was downloaded")


def _download(wants: Sequence[WantedFile]) -> None:
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TransferSpeedColumn

    from station.assets import fetch as fetching

    console = Console(stderr=True)
    with Progress(
        BarColumn(), DownloadColumn(), TransferSpeedColumn(), console=console, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task("", total=sum(want.file.size_bytes for want in wants))
        fetching.download(wants, on_bytes=lambda count: progress.advance(task, count))


def _print_shadowed(order: FetchRequest) -> None:
    shadows = [want for want in order.wants if want.shadow is not None]
    if shadows:
        first, more = shadows[0], f" and {len(shadows) - 1} more" if shadows[1:] else ""
        click.echo(
            f"! {first.reference}{more} will still not be what was fetched: ${assets.ENVIRONMENT_VARIABLE} comes first "
            f"and has another file, {first.shadow}",
            err=True,
        )


def _count(wants: Sequence[WantedFile]) -> str:
    return f"{len(wants)} file{'s' if len(wants) != 1 else ''}"


def _print(items: Sequence[Item], motions: Sequence[str]) -> None:
    """Print a table; what a file needs is counted in its row."""
    titles = ("file", "where", "size", "licence", "fetch", "")
    columns = [Column(title, "right" if title == "size" else "left") for title in titles]
    parts: dict[str, list[Item]] = {}
    for item in items:
        if item.needed_by:
            parts.setdefault(item.needed_by, []).append(item)
    print_table(columns, [_row(item, parts.get(item.reference, [])) for item in items if not item.needed_by])
    if motions:
        click.echo(f"\nmotions that need no file: {' '.join(motions)}")
    if names := sorted({item.bundle for item in items if item.where == "not here"}):
        click.echo(f"\nto download what is not here: station assets fetch {' '.join(names)}")


def _row(item: Item, parts: Sequence[Item]) -> Sequence[str]:
    whole = [item, *parts]
    name = escape(item.reference) + (f" [dim]+ {len(parts)}[/]" if parts else "")
    colour = _COLOURS.get(item.where, "green")
    problems = [f"{each.reference} {each.problem}" if each in parts else each.problem for each in whole if each.problem]
    if apart := [each for each in parts if each.where != item.where]:
        problems.append(f"{apart[0].reference} is {apart[0].where}")
    more = f" and {len(problems) - 1} more" if problems[1:] else ""
    problem = f"[red]{escape(problems[0])}{more}[/]" if problems else ""
    size = _size(sum(each.size_bytes for each in whole))
    return name, f"[{colour}]{item.where}[/]", size, item.licence or "–", item.bundle, problem


def _size(count_bytes: int) -> str:
    return f"{count_bytes / 1e6:.1f} MB" if count_bytes >= 1e6 else f"{count_bytes / 1e3:.1f} kB"
