"""What several verbs share: options, and groups of verbs that know what was meant."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.cli import candidates
from station.errors import UnknownName

if TYPE_CHECKING:
    from station.bus.address import BusAddress

PROGRAM = "station"
COMPLETION_VARIABLE = "_STATION_COMPLETE"
"""Set by the shell that wants a command line completed."""

_WHOLE = 1000  # characters of a sentence
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def _without_password(_context: click.Context, _option: click.Parameter, url: str | None) -> str | None:
    """Warn of a password among the arguments; a URL that is none is told of where it is read."""
    if url == "":
        raise click.UsageError("--bus: expected an address such as redis://robot:6379 or unix:///path, got nothing")
    if url and re.match(r"^[^/]*//[^/@]*:[^/@]+@", url):
        from station.bus import address as addresses

        click.echo(
            "station: a password in --bus shows in the process list of every user; "
            f"put it into a file that ${addresses.PASSWORD_FILE_VARIABLE} names",
            err=True,
        )
    return url


class NamedPath(click.Path):
    """A file or folder that has a name: an unset variable of a script does not name the folder that one is in."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path that a word of the command line names."""
        if value == "":
            self.fail("expected a path, got nothing", param, ctx)
        return super().convert(value, param, ctx)


bus_option: Decorator = click.option(
    "--bus", metavar="URL", default=None, callback=_without_password,
    help="redis://, rediss:// or unix:// address.  [default: $STATION_BUS, else of your config, else your own socket]",
)  # fmt: skip
data_option: Decorator = click.option(
    "--data", metavar="DIR", default=None, type=NamedPath(file_okay=False, path_type=Path),
    help="Folder of episodes.  [default: $STATION_DATA, else of your config, else ./data]",
)  # fmt: skip
jobs_option: Decorator = click.option(
    "--jobs", metavar="N", default=0, type=click.IntRange(0), help="Processes side by side.  [default: one per core]"
)
task_option: Decorator = click.option(
    "--task", metavar="NAME", multiple=True, shell_complete=candidates.tasks,
    help="Episodes of this task alone; may repeat.",
)  # fmt: skip
episode_argument: Decorator = click.argument("episode", shell_complete=candidates.episodes)
json_option: Decorator = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")


class Verbs(click.Group):
    """A group that says which verb was meant when a name is misspelt, and cuts no help."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what each verb does, in its first sentence."""
        verbs = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        with formatter.section("Commands"):
            formatter.write_dl([
                (name, verb.get_short_help_str(limit=_WHOLE)) for name, verb in verbs.items() if verb is not None
            ])  # fmt: skip

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb that the first word names.

        Raises:
            UnknownName: there is none.
        """
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            raise UnknownName(f"`{ctx.command_path}` command", name, self.list_commands(ctx))
        return super().resolve_command(ctx, args)


def set_option(form: str) -> Decorator:
    """Return the ``--set`` option; `form` is ``key=value`` or ``server.key=value``."""
    return click.option("--set", "sets", multiple=True, metavar=form.upper(), help="Change a setting; may repeat.")


def address_of(bus: str | None) -> BusAddress:
    """Return the bus that ``--bus`` names, or the default one."""
    from station.bus import address as addresses

    return addresses.parse(bus) if bus else addresses.default()
