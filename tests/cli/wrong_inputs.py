"""Wrong inputs by the thousand: each verb with what it does not know, without what it needs, and with odd values."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import click

from station.cli.main import cli
from tests.waiting import DEADLINE_S

ODD = (
    "", "nope", "/dev/null/x", "folder", "file.txt", "-1", "9" * 400, "\x1b[31mred", "日本語", "nan", "1e999", "a=b",
    "../..", "\udcff\udcfe", "x" * 5000,
)  # fmt: skip
"""Wrong values: mistyped, pasted, or from a shell variable that is not set."""

BARE = {"COLUMNS": "60", "PYTHONIOENCODING": "latin-1", "LC_ALL": "C", "DISPLAY": "", "WAYLAND_DISPLAY": ""}
"""Variables of a narrow terminal that is not UTF-8, on a machine without a display."""

RUNS_ON = frozenset([
    "demo", "up", "serve", "console", "bus start", "rehearse", "view", "status", "logs", "devices fake",
    "devices voices",
    "kassow controller", "devices calibrate gello", "devices calibrate glove", "devices calibrate natnet",
    "devices calibrate pico",
])  # fmt: skip
"""Verbs that do their work, for long, with many an odd value."""


class Case(NamedTuple):
    """A command line.

    Attributes:
        words: Behind ``station``.
        is_refused: Whether nothing of it can be done: a mistake in how it was called.
    """

    words: tuple[str, ...]
    is_refused: bool


def cases() -> Iterator[Case]:
    """Yield every wrong input, verb by verb."""
    for path, verb in _verbs(cli, (), None):
        yield Case((*path, "--nope"), is_refused=True)
        for param in verb.params:
            if param.required:
                yield Case((*path, *_needed(verb, without=param)), is_refused=True)
            if getattr(param, "is_flag", False):
                continue
            is_typed = isinstance(param.type, click.Choice | click.types.IntParamType | click.types.FloatParamType)
            if " ".join(path) in RUNS_ON and not is_typed:
                continue
            for odd in ODD:
                words = [odd] if isinstance(param, click.Argument) else [param.opts[-1], odd]
                is_refused = isinstance(param.type, click.Choice)
                yield Case((*path, *_needed(verb, without=param), *words), is_refused)


def complaint(case: Case, place: Path, environment: Mapping[str, str], encoding: str = "utf-8") -> str:
    """Run a case in a folder; return what is wrong with how it was answered, or ""."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "station", *case.words], cwd=place, env=dict(environment), stdin=subprocess.DEVNULL,
            capture_output=True, encoding=encoding, errors="replace", timeout=DEADLINE_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"{_shown(case)}: hangs"
    wrong = []
    if "Traceback" in done.stdout + done.stderr:
        wrong.append("traceback")
    if done.returncode not in ((2,) if case.is_refused else (0, 1, 2)):
        wrong.append(f"exit code {done.returncode}")
    said = done.stderr.splitlines()
    if done.returncode and not (said or done.stdout):
        wrong.append("says nothing")
    if case.is_refused and len(said) != 1:
        wrong.append(f"{len(said)} lines")
    if done.returncode and said and not said[-1].startswith("station: "):
        wrong.append("its last line is not of the station")
    return f"{_shown(case)}: {', '.join(wrong)}: {done.stderr[-1000:]}" if wrong else ""


def furnish(place: Path) -> None:
    """Put there what odd values name."""
    (place / "folder").mkdir()
    (place / "file.txt").write_text("text", encoding="utf-8")


def _verbs(
    command: click.Command, path: tuple[str, ...], parent: click.Context | None
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    context = click.Context(command, info_name=path[-1] if path else "station", parent=parent)
    if not isinstance(command, click.Group):
        yield path, command
        return
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None
        yield from _verbs(found, (*path, name), context)


def _needed(verb: click.Command, without: click.Parameter) -> Iterator[str]:
    """Yield what a verb cannot go without, but for one parameter."""
    for param in verb.params:
        if not param.required or param is without:
            continue
        if isinstance(param, click.Option):
            yield param.opts[-1]
        yield str(param.type.choices[0]) if isinstance(param.type, click.Choice) else "3"


def _shown(case: Case) -> str:
    return "station " + " ".join(
        repr(word) if len(word) < 40 else f"{word[:5]!r}… ({len(word)})" for word in case.words
    )
