"""Speech programs that are not there: each notes how it was called, one line of JSON a call."""

from __future__ import annotations

import json
import sys
from pathlib import Path

_PROGRAM = """#!{python}
import json, sys, time
with open({log!r}, "a") as log:
    log.write(json.dumps(sys.argv) + "\\n")
{then}
"""


def put(folder: Path, name: str, *, then: str = "") -> Path:
    """Put a program into a folder that is to be on the path; return its log. `then` is Python that it goes on with."""
    folder.mkdir(exist_ok=True)
    log = folder.parent / f"{name}.log"
    program = folder / name
    program.write_text(_PROGRAM.format(python=sys.executable, log=str(log), then=then))
    program.chmod(0o755)
    return log


def calls(log: Path) -> list[list[str]]:
    """Return the arguments of each call so far."""
    lines = log.read_text().splitlines(keepends=True) if log.exists() else []
    return [json.loads(line)[1:] for line in lines if line.endswith("\n")]
