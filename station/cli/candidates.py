"""What a shell may complete beside verbs and options: quick to find, and found without a bus."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import click

from station import packages

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from station.registry import Kind

    Candidates = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]

_NEWEST = 30  # episodes; more do not help anybody to choose
_ONE_WORD = re.compile(r"[\w.-]+")  # to a shell; it takes other names apart


def files(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Files."""
    from click.shell_completion import CompletionItem

    return [CompletionItem(begun, type="file")]


def runbooks(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Runbooks that ship, and files."""
    return files(context, parameter, begun) + shipped_runbooks(context, parameter, begun)


def pages(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Pages of the docs."""
    return _fitting(begun, sorted(path.stem for path in packages.docs().glob("*.md")))


def shipped_runbooks(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Runbooks that ship."""
    return _fitting(begun, sorted(path.stem for path in packages.RUNBOOKS.glob("*.yaml")))


def episodes(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """The newest episodes of the data folder, and files."""
    from station.episode.storage.folder import LATEST, newest_ids

    known = [LATEST, *newest_ids(context.params.get("data"), begun, _NEWEST)]
    return files(context, parameter, begun) + _fitting(begun, known)


def in_bin(context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Episodes in the bin of the data folder."""
    from station.episode.storage.bin import in_bin
    from station.episode.storage.folder import data_folder

    return _fitting(begun, [folder.name for folder in in_bin(data_folder(context.params.get("data")))])


def tasks(context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Tasks that have a folder of episodes."""
    from station.episode.storage.folder import tasks

    return _fitting(begun, tasks(context.params.get("data")))


def logs(context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Servers of which there is a log."""
    from station.bus import address as addresses
    from station.supervision.supervisor import log_folder

    bus = context.params.get("bus")
    folder = log_folder(addresses.parse(bus) if bus else addresses.default())
    return _fitting(begun, sorted(file.stem for file in folder.glob("*.log")))


def described(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Robots and keys that are known without a bus."""
    from station.bus import contracts

    return _fitting(begun, [*contracts.robots(), *(item.key for item in contracts.contracts())])


def registered(kind: Kind) -> Candidates:
    """Return what finds names that are registered."""
    return lambda _context, _parameter, begun: names(kind, begun)


def names(kind: Kind, begun: str) -> list[CompletionItem]:
    """Return registered names; loads nothing that they stand for."""
    from station import registry

    return _fitting(begun, registry.names(kind))


def _fitting(begun: str, known: Iterable[str]) -> list[CompletionItem]:
    from click.shell_completion import CompletionItem

    return [CompletionItem(name) for name in known if name.startswith(begun) and _ONE_WORD.fullmatch(name)]
