"""What a process of the station says on stderr: lines for a person, or an object per line for a program."""

from __future__ import annotations

import json
import logging
import os
import time
from typing import Any

from station.printable import printable

LEVEL, FORMAT = "STATION_LOG", "STATION_LOG_FORMAT"
"""Variables; servers that `station up` starts obey them too."""
LONGEST = 4000
"""Characters of a line that is said: it may quote what a stranger wrote on the bus."""

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
