"""``station up``: run a runbook."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

from station import config, user_config
from station.bus.client import Bus
from station.cli import candidates
from station.cli.options import bus_option, data_option, set_option
from station.episode.storage.folder import data_folder
from station.episode.storage.request import RecordAnswer
from station.errors import UsageError
from station.life.stop_line import StopLine
from station.stop_signals import ENDING, set_on_signals
from station.supervision import claims
from station.supervision import runbook as runbooks
from station.supervision.runbook import Runbook, StartStep
from station.supervision.session import Recording, Session
from station.supervision.supervisor import Supervisor, how_it_ended, log_folder


@click.command("up")
@click.argument("runbook", default="", shell_complete=candidates.runbooks)
@click.option(
    "--yes", is_flag=True, help="Answer confirmations with yes; recorded as unattended, refused for a real robot."
)
@click.option("--ask", "ask", type=click.Choice(["terminal", "console"]), default="terminal", show_default=True,
              help="Who is asked where nobody can type here: nobody, or whoever answers from a console.")  # fmt: skip
@click.option("--console", "is_console", is_flag=True,
              help="Serve a page to watch, stop, record and answer from; prints its links.")  # fmt: skip
@click.option("--record", is_flag=True, help="Record an episode from before the robot moves until the end.")
@click.option("--task", default="", shell_complete=candidates.tasks,
              help="Name of the task, for the episode.  [default: the runbook's name]")  # fmt: skip
@click.option("--instruction", default="", help="Language instruction, for the episode.")
@click.option(
    "--operator", default="", help="Who operates, for the episode.  [default: of your config, else your login name]"
)
@click.option("--for", "for_", metavar="DURATION", default=None, help="Stop after this long (25s, 2min).")
@click.option("--on", "hosts", metavar="SERVER=HOST", multiple=True,
              help="Run a server on a machine that has joined the bus (`station host join` there).")  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Print what would happen and exit.")
@set_option("server.key=value")
@data_option
@bus_option
def command(
    runbook: str, yes: bool, ask: str, is_console: bool, record: bool, task: str, instruction: str, operator: str,
    for_: str | None, hosts: tuple[str, ...], dry_run: bool, sets: tuple[str, ...], data: Path | None, bus: str | None,
) -> None:  # fmt: skip
    """Run RUNBOOK (a file, or the name of one that ships) in order, and take it all down again at the end."""
    if yes and ask == "console":
        raise UsageError("--yes and --ask console: expected one of them; --yes asks nobody")
    book = runbooks.load(runbooks.find(runbook), sets, hosts, first=("console",) if is_console else ())
    if dry_run:
        print_plan(book)
        book.expect_found()
        return
    book.expect_found()
    if is_console:
        print_links(book)
    recording = None
    for_s = None if for_ is None else config.seconds(for_, where="--for")
    if record:
        person = {"id": user_config.operator(operator)}
        recording = Recording(task=task or book.name, instruction=instruction, operator=person, planned_s=for_s)
    code, episode = run(
        book, bus=bus, data=data_folder(data), recording=recording, unattended=yes, for_s=for_s,
        waits_for_console=ask == "console" or (is_console and not yes),
    )  # fmt: skip
    if episode:
        click.echo(episode)
    raise SystemExit(code)


def run(
    book: Runbook, *, bus: str | None, data: Path, recording: Recording | None, unattended: bool, for_s: float | None,
    is_brief: bool = False, waits_for_console: bool = False,
) -> tuple[int, str]:  # fmt: skip
    """Run a runbook in this terminal; return the exit code and the folder of the episode, "" where none was recorded;
    of one that was recorded on another machine, that machine's name and a colon before it.

    `is_brief` shows progress to somebody who looks on, rather than servers to somebody who operates; with
    `waits_for_console` a question waits for an answer on the bus where nobody can type here.
    """
    from station.bus import address as addresses
    from station.bus.discovery import found_or_started
    from station.cli.terminal_ui import TerminalUI
    from station.operator.device import LENT_TERMINAL

    named = addresses.parse(bus) if bus else None
    names = [step.start for step in book.servers]
    with (
        claims.claimed(named or addresses.default(), names),
        _stop_on_signals() as stop,
        TerminalUI(stop, is_brief=is_brief, waits_for_console=waits_for_console) as face,
        found_or_started(named, on_restart=lambda text: face.report(text, "warning")) as address,
    ):
        with (
            Bus(address, name="supervisor", timeout_s=1.0) as line,
            face.watching(line, names),
            ExitStack() as stopping,
        ):
            variables = {"STATION_DATA": str(data.absolute()), LENT_TERMINAL: face.lent_terminal}
            supervisor = Supervisor(line, log_folder(address), variables)
            face.estop_directly, face.look_for_dead = supervisor.estop, lambda: _died(supervisor)
            stop_line = stopping.enter_context(StopLine(address, supervisor.estop))
            if stop_line.failure:
                face.report(stop_line.failure, "warning")
            session = Session(book, line, supervisor, face, data=data, recording=recording, is_unattended=unattended)
            try:
                code = session.run(stop, for_s=for_s)
            except KeyboardInterrupt:
                face.report("interrupted again: stopping everything now, in no particular order", "warning")
                raise
            finally:
                supervisor.stop_all()
        host = session.recorder_host
        if session.episode is not None:
            where = f"on host {host} " if host else ""
            face.report(
                f"recorded {_summary(session.episode)}; look at it {where}with: station check {session.episode.path}"
            )
        path = (session.episode.path or "") if session.episode is not None else ""
        return code, f"{host}:{path}" if host and path else path


def _died(supervisor: Supervisor) -> dict[str, str]:
    """Return how servers ended that did not end well and are not started again, by name."""
    return {name: how_it_ended(code) for name, code in supervisor.ended().items() if code}


def _summary(episode: RecordAnswer) -> str:
    """Return in words what the recorder counted; of an episode that it did not close it knows nothing."""
    counted = episode.summary
    shown = f"{episode.episode_id}"
    if counted:
        shown += f": {counted['seconds']:.1f} s, {counted['messages']} messages, {counted['lost']} lost"
        shown += f", {counted['dropped']} dropped" if counted["dropped"] else ""
    return shown


def print_links(book: Runbook) -> None:
    """Print where the console of a station will be, with what lets a page in."""
    from station.web import links
    from station.web.config import ConsoleConfig

    for step in book.servers:
        if isinstance(step.config, ConsoleConfig) and not step.host:
            for role, link in links.of(step.config).items():
                click.echo(f"{role}: {link}")


def print_plan(book: Runbook) -> None:
    """Print the steps of a runbook."""
    click.echo(f"{book.name} · {book.description}" if book.description else book.name)
    for number, step in enumerate(book.steps, 1):
        within = f"  (ready within {step.ready_within_s:g} s{_fate(step)})" if isinstance(step, StartStep) else ""
        click.echo(f"{number:3}. {step}{within}")
    click.echo(f"at the end, stop: {', '.join(step.start for step in reversed(book.servers)) or 'nothing'}")
    click.echo(f"on failure, stop: {', '.join(book.stop_order) or 'nothing'}")


def _fate(step: StartStep) -> str:
    return "" if step.if_it_dies == "ask" else f"; if it dies: {step.if_it_dies}"


@contextmanager
def _stop_on_signals() -> Iterator[threading.Event]:
    """Turn the first Ctrl-C, SIGTERM or closed terminal into an orderly end; the second Ctrl-C interrupts that."""
    stop = threading.Event()
    end = set_on_signals(stop, (*ENDING, signal.SIGHUP), second_interrupts=True)
    try:
        yield stop
    finally:
        end()
