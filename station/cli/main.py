"""The ``station`` command: one verb per module, each imported only when it is used."""

from __future__ import annotations

import errno
import importlib
import io
import keyword
import os
import sys
from typing import TYPE_CHECKING, NoReturn

import click

from station import python_child
from station.cli import log_lines
from station.cli.options import COMPLETION_VARIABLE, PROGRAM, Verbs
from station.errors import StationError, UsageError
from station.printable import printable

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

_BAD_NAME = (errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EISDIR)
_SHOWN = 100  # characters of such a name

VERBS = {
    "demo": "Drive a simulated G1 once, record it, print the report.",
    "up": "Run a runbook: start a station, watch over it, take it down.",
    "init": "Make a folder to work in: a runbook, rules, a place for episodes.",
    "runbooks": "List the runbooks that ship, show one, or copy one to change it.",
    "motions": "List the motions that can be played, or look whether a file of yours can.",
    "retarget": "Make motions of a robot of people's motion capture: BVH, AMASS, C3D.",
    "serve": "Run one server in this terminal.",
    "down": "End the station that runs, in order, as Ctrl-C in its terminal does.",
    "host": "Let a station on another machine start servers here.",
    "logs": "Print what the servers said; --follow goes on.",
    "settings": "List the servers, or the settings of one and what they mean.",
    "console": "Show the station in a browser: robot, cameras, curves, and a stop.",
    "pair": "Print code and link that let a headset, a phone or a browser in.",
    "status": "Show servers and their states, keys, rates and ages.",
    "doctor": "Find out why the robot does nothing, and what to do.",
    "estop": "Stop every robot on the bus; --reset releases.",
    "arm": "Let targets go to a robot, with a gentle start.",
    "disarm": "Send nothing to a robot any more.",
    "release-motors": "Have a real robot's own controller let go of its motors.",
    "policy": "See which policy drives a robot; have another take over.",
    "record": "Start, stop, mark or discard an episode.",
    "episodes": "List, show, check and look after what has been recorded.",
    "check": "Measure an episode from its file, and judge it.",
    "enrich": "Write typed topics of an episode, for Rerun, Foxglove and others.",
    "export": "Make training data, or files for a quick look, of episodes.",
    "import": "Make episodes of what other recorders recorded.",
    "report": "Make an HTML page of episodes: verdicts, times, pictures, columns.",
    "audit": "Run the policy again on what was recorded, and compare bits.",
    "replay": "Play an episode to a bus, a simulation or Rerun.",
    "rehearse": "Run motions through policy and simulation, offline.",
    "view": "Show a running station or an episode; draw its pictures.",
    "kassow": "Look after an arm's controller: clear faults, simulate one, show its traps.",
    "robot-twin": "Stand in for a real robot at the other end of its cable; switch its faults.",
    "bus": "Start a bus, or look at one.",
    "keys": "Say what each key of the bus holds.",
    "describe": "Show a robot's joints, limits and keys, or what a key holds now.",
    "devices": "Find operators' devices, play fakes of them, show their buttons, calibrate.",
    "assets": "Find and fetch policies, robot models and motions.",
    "docs": "Read the docs of this version.",
    "completion": "Print a script that lets bash, zsh or fish complete all of this.",
}
"""What each verb does; its module holds its ``command``."""


def module_of(verb: str) -> str:
    """Return the module of a verb: ``station.cli.<verb>``; an underscore for each hyphen, and behind Python's words."""
    return f"station.cli.{verb.replace('-', '_')}{'_' if keyword.iskeyword(verb) else ''}"


class _LazyVerbs(Verbs):
    """Finds its commands by module name, so that ``station --help`` imports none of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        with python_child.importing():
            command: click.Command = importlib.import_module(module_of(cmd_name)).command
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        verbs = [CompletionItem(verb, help=what) for verb, what in VERBS.items() if verb.startswith(incomplete)]
        return verbs + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=_LazyVerbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="teleop-station", prog_name="station")
def cli() -> None:
    """Teleop Station: drive a humanoid over a Redis bus, record every write, check, audit and replay it."""


def main() -> NoReturn:
    """Run the command line; every known error is one line on stderr and an exit code."""
    python_child.protect_children()
    python_child.spare_processors()
    python_child.keep_imports()
    if COMPLETION_VARIABLE in os.environ:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())  # a shell would show it amid what is being typed
    os.environ.setdefault("RUST_LOG", "off")  # Rerun's own log, on stderr in colours: what matters of it is raised
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.encoding.lower().replace("-", "") != "utf8":
            stream.reconfigure(errors="replace")  # a mark that this terminal has not is no reason to fail
    log_lines.begin()
    try:
        code = cli.main(prog_name=PROGRAM, complete_var=COMPLETION_VARIABLE, standalone_mode=False)
        sys.stdout.flush()
    except click.ClickException as error:
        _show(error)
        code = error.exit_code
    except StationError as error:
        _complain(str(error))
        code = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        _complain("interrupted")
        code = 130
    except BrokenPipeError:
        _drop_output()  # its reader (head, less) has gone
        code = 0
    except OSError as error:
        if error.errno in _BAD_NAME and error.filename is not None:
            _complain(
                f"{printable(os.fsdecode(error.filename), _SHOWN)}: {error.strerror}; name another file or folder"
            )
            code = UsageError.exit_code
        elif error.errno in (errno.ENOSPC, errno.EDQUOT):
            _complain(f"{error.filename or 'the output'}: cannot be written: {error.strerror}")
            _drop_output()
            code = 1
        else:
            raise
    sys.exit(code if isinstance(code, int) else 0)


def _drop_output() -> None:
    """Let Python not try again at exit to write what could not be written."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(text: str) -> None:
    """Say why this process ends, to whoever reads its last words: in plain words, whatever its log is written for."""
    click.echo(f"station: {printable(text, log_lines.LONGEST)}", err=True)


def _show(error: click.ClickException) -> None:
    """Show a mistake in a line, with where it is explained; a group without a verb shows its help."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is None:
        _complain(error.format_message())
    elif error.format_message() == context.get_help():
        click.echo(error.format_message(), err=True)
    else:
        told = " ".join(error.format_message().split()).rstrip(".")  # click lists choices in lines of their own
        _complain(f"{told}{'' if told.endswith('?') else '.'} See `{context.command_path} --help`.")
