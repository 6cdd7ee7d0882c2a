"""The ``station`` command: one verb per module, each imported only when it is used."""

from __future__ import annotations

import importlib
import logging
import os
import sys
from typing import NoReturn

import click

from station.errors import StationError

_VERBS = {
    "demo": "station.cli.demo",
    "up": "station.cli.up",
    "serve": "station.cli.serve",
    "status": "station.cli.status",
    "keys": "station.cli.keys",
    "record": "station.cli.record",
    "episodes": "station.cli.episodes",
    "check": "station.cli.check",
    "audit": "station.cli.audit",
    "replay": "station.cli.replay",
    "rehearse": "station.cli.rehearse",
    "view": "station.cli.view",
    "estop": "station.cli.estop",
    "bus": "station.cli.bus",
    "assets": "station.cli.assets",
    "doctor": "station.cli.doctor",
}


class _Verbs(click.Group):
    """A group that finds its commands by module name, so that ``station --help`` imports none of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        module = _VERBS.get(cmd_name)
        if module is None:
            return None
        command: click.Command = importlib.import_module(module).command
        return command


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="teleop-station", prog_name="station")
def cli() -> None:
    """Teleop Station: drive a humanoid over a Redis bus, record every write, check, audit and replay it."""


def main() -> NoReturn:
    """Run the command line; every known error is one line on stderr and an exit code."""
    logging.basicConfig(level=os.environ.get("STATION_LOG", "INFO"), format="%(levelname).1s %(name)s: %(message)s")
    logging.captureWarnings(True)
    try:
        code = cli.main(standalone_mode=False)
    except click.UsageError as error:
        error.show()
        code = 2
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except StationError as error:
        click.echo(f"station: {error}", err=True)
        code = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo("station: interrupted", err=True)
        code = 130
    except BrokenPipeError:
        # The reader of our output (head, less) has gone; nothing is left to say, and Python must not try at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code if isinstance(code, int) else 0)
