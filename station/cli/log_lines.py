"""What a process of the station says on stderr: lines for a person, or an object per line for a program."""

from __future__ import annotations

import json
import logging
import os
import time
from typing import Any

import click

from station.errors import UsageError
from station.printable import printable

LEVEL, FORMAT = "STATION_LOG", "STATION_LOG_FORMAT"
"""Variables; servers that `station up` starts obey them too."""

_LEVELS = ("debug", "info", "warning", "error")
_FORMATS = ("text", "json")
_LONGEST = 4000  # characters of a message: it may quote what a stranger wrote on the bus


def begin() -> None:
    """Log as the two variables ask: ``info`` and ``text`` where they are not set.

    Raises:
        UsageError: one of them has no such value.
    """
    level, wanted = _asked(LEVEL, _LEVELS, "info"), _asked(FORMAT, _FORMATS, "text")
    handler = logging.StreamHandler()
    handler.setFormatter(_Objects() if wanted == "json" else _Lines("%(levelname).1s %(name)s: %(message)s"))
    logging.basicConfig(level=level.upper(), handlers=[handler])
    logging.captureWarnings(True)


def complain(text: str) -> None:
    """Say why this process ends."""
    if os.environ.get(FORMAT, "").lower() == "json":
        logging.getLogger("station").error("%s", text)
    else:
        click.echo(f"station: {printable(text, _LONGEST)}", err=True)


def _asked(variable: str, known: tuple[str, ...], default: str) -> str:
    value = os.environ.get(variable) or default
    if value.lower() not in known:
        raise UsageError(f"${variable} is {value[:40]!r}; expected {', '.join(known)}")
    return value.lower()


class _Lines(logging.Formatter):
    """A message keeps to its line."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  the library's name
        return printable(super().formatMessage(record), _LONGEST)


class _Objects(logging.Formatter):
    """A JSON object per message: time (UTC), level, logger, pid, message, and the traceback where there is one."""

    def format(self, record: logging.LogRecord) -> str:
        seconds = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        found: dict[str, Any] = {
            "time": f"{seconds}.{int(record.created % 1 * 1e6):06d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "pid": record.process,
            "message": record.getMessage()[:_LONGEST],
        }
        if record.exc_info:
            found["traceback"] = self.formatException(record.exc_info)
        return json.dumps(found)
