"""What a process of the station says on stderr: lines for a person, or an object per line for a program."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

from station.printable import printable

LEVEL, FORMAT = "STATION_LOG", "STATION_LOG_FORMAT"
"""Variables; servers that `station up` starts obey them too."""
LONGEST = 4000
"""Characters of a line that is said: it may quote what a stranger wrote on the bus."""

_MOST_KEPT = 1000
_LAST_S = 1.0

_LEVELS = ("info", "debug", "warning", "error", "critical")
_FORMATS = ("text", "json")


def begin() -> None:
    """Log as the two variables ask: ``info`` and ``text`` where they are not set.

    A value that is not known is told and costs nothing else: an emergency stop goes through whatever a variable holds.
    """
    (level, *of_level), (form, *of_form) = _asked(LEVEL, _LEVELS), _asked(FORMAT, _FORMATS)
    handler = logging.StreamHandler()
    handler.setFormatter(_Objects() if form == "json" else _Lines("%(levelname).1s %(name)s: %(message)s"))
    logging.basicConfig(level=level.upper(), handlers=[handler])
    logging.captureWarnings(True)
    for problem in of_level + of_form:
        logging.getLogger("station").warning("%s", problem)


@contextlib.contextmanager
def never_waited_for() -> Iterator[None]:
    """Have what is logged written by a thread of its own, so that no control loop waits for whoever takes the lines.

    A disk that takes seconds, a terminal that Ctrl-S holds and a pipe that nobody reads stop who writes to them. At
    most `_MOST_KEPT` lines wait for them; a line tells how many more there were. The last ones get `_LAST_S`.
    """
    root = logging.getLogger()
    direct = root.handlers
    root.handlers = [kept := _Kept(direct[0].formatter)]
    try:
        yield
    finally:
        root.handlers = direct
        kept.finish()


class _Kept(logging.Handler):
    """Keeps lines for the thread that writes them to stderr."""

    def __init__(self, formatter: logging.Formatter | None) -> None:
        super().__init__()
        self.formatter = formatter
        # Not by `sys.stderr`: a thread that waits within holds its lock, and Python aborts at the end of the process.
        self._descriptor = sys.stderr.fileno()
        self._lines: queue.Queue[str | None] = queue.Queue(_MOST_KEPT)
        self._more = 0
        self._thread = threading.Thread(target=self._write_all, name="log", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:  # within the handler's lock
        try:
            self._lines.put_nowait(self.format(record))
        except queue.Full:
            self._more += 1

    def finish(self) -> None:
        with contextlib.suppress(queue.Full):
            self._lines.put(None, timeout=_LAST_S)
        self._thread.join(_LAST_S)

    def _write_all(self) -> None:
        line: str | None = ""
        while line is not None:
            if (line := self._lines.get()) is not None:
                self._write(line)
            if line is None or self._lines.empty():
                self._tell_how_many_more()

    def _tell_how_many_more(self) -> None:
        self.acquire()
        more, self._more = self._more, 0
        self.release()
        if more:
            text = f"{more} more lines were not kept: whoever takes this log was too slow"
            self._write(self.format(logging.LogRecord(__name__, logging.WARNING, "", 0, text, None, None)))

    def _write(self, line: str) -> None:
        left = f"{line}\n".encode(errors="backslashreplace")
        with contextlib.suppress(OSError):  # nobody takes it, and nowhere else is where to say so
            while left:
                left = left[os.write(self._descriptor, left) :]


def _asked(variable: str, known: tuple[str, ...]) -> tuple[str, ...]:
    """Return what a variable asks for, the first of ``known`` by default; behind it what is wrong with its value."""
    value = os.environ.get(variable) or known[0]
    if value.lower() in known:
        return (value.lower(),)
    return known[0], f"${variable} is {value[:40]!r}; expected {', '.join(known)}; taken for {known[0]}"


class _Lines(logging.Formatter):
    """A message keeps to its line."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  the library's name
        return printable(super().formatMessage(record), LONGEST)


class _Objects(logging.Formatter):
    """A JSON object per message: time (UTC), level, logger, pid, message, and the traceback where there is one."""

    def format(self, record: logging.LogRecord) -> str:
        seconds = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        found: dict[str, Any] = {
            "time": f"{seconds}.{int(record.created % 1 * 1e6):06d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "pid": record.process,
            "message": record.getMessage()[:LONGEST],
        }
        if record.exc_info:
            found["traceback"] = self.formatException(record.exc_info)
        return json.dumps(found)
