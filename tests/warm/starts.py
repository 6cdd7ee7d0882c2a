"""Start Python children warm: `subprocess` and `multiprocessing` ask the fork server where a child would be the same as
one started cold."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from multiprocessing import util
from pathlib import Path
from typing import Any

from station.python_child import SAFE_PATH
from tests.warm import fork_server

ROOT = Path(__file__).parents[2]
WARM_MODULES = ("station", "tests.", "adapters.")
"""Modules, or beginnings of their names, that run as warm children."""

LASTING: set[int] = set()
"""Processes that are there for all tests of a run, whichever starts them: they are no leftovers."""

_READ_AT_IMPORT = (
    "PYTHON", "LD_", "MUJOCO_", "OMP_", "OPENBLAS_", "MKL_", "ORT_", "LANG", "LC_", "TZ", "MALLOC_", "RAY_"
)  # fmt: skip
"""Beginnings of variables that a library or the interpreter reads when it starts: a child with others starts cold."""
_SHARES_WORK = "--multiprocessing-fork"  # last word of a child that has a target; the tracker of resources has none
_DRAWS_NOTHING = ("MUJOCO_GL", "disable")  # leaves out an import that the fork server has made


class WarmStarts:
    """Children of this process, forked by a fork server that is a child of it too.

    Args:
        line: To the fork server, which has to be idle; without one it is started by the first child.
    """

    def __init__(self, line: socket.socket | None = None) -> None:
        self._line, self._lock = line, threading.Lock()
        self._before = subprocess.Popen._execute_child  # type: ignore[attr-defined]
        self._spawn_before = util.spawnv_passfds  # type: ignore[attr-defined]
        self._environment = _read_at_import(os.environ)
        self._server: subprocess.Popen[bytes] | None = None
        self.started = 0

    def install(self) -> None:
        """Let `subprocess.Popen`, and `multiprocessing` where it spawns, start children warm."""
        starts = self

        def execute(process: subprocess.Popen[Any], *arguments: Any) -> None:
            if not starts._execute(process, *arguments):
                starts._before(process, *arguments)

        def spawn(path: Any, args: Sequence[Any], passed: Sequence[int]) -> int:
            pid = starts._spawn(args, [int(number) for number in passed])
            return starts._spawn_before(path, args, passed) if pid is None else pid

        subprocess.Popen._execute_child = execute  # type: ignore[attr-defined]
        util.spawnv_passfds = spawn  # type: ignore[attr-defined]

    def uninstall(self) -> None:
        """Start children cold again, and let the fork server end."""
        subprocess.Popen._execute_child = self._before  # type: ignore[attr-defined]
        util.spawnv_passfds = self._spawn_before  # type: ignore[attr-defined]
        if self._line is not None:
            self._line.close()
        if self._server is not None:
            self._server.wait()

    def _execute(
        self, process: Any, args: Any, executable: Any, preexec_fn: Any, close_fds: Any, pass_fds: Any, cwd: Any,
        env: Any, startupinfo: Any, creationflags: Any, shell: Any, p2cread: int, p2cwrite: int, c2pread: int,
        c2pwrite: int, errread: int, errwrite: int, restore_signals: bool, gid: Any, gids: Any, uid: Any, umask: int,
        start_new_session: bool, process_group: int,
    ) -> bool:  # fmt: skip
        """Start a child warm; return False, with nothing done, where it has to start cold."""
        words = [os.fspath(word) for word in args] if isinstance(args, list | tuple) else []
        folder = os.fspath(cwd) if cwd is not None else os.getcwd()
        environment = dict(os.environ if env is None else env)
        if executable or preexec_fn or shell or not close_fds or (gid, gids, uid) != (None, None, None):
            return False
        program = _program(words, folder, bool(environment.get(SAFE_PATH)))
        if program is None or _read_at_import(environment) != self._environment or not os.path.isdir(folder):
            return False
        old_mask = os.umask(0)
        os.umask(old_mask)
        descriptors = [
            given if given >= 0 else number for number, given in enumerate((p2cread, c2pwrite, errwrite))
        ] + sorted(pass_fds)  # fmt: skip
        request = fork_server.Request(
            program, folder, environment, [0, 1, 2, *sorted(pass_fds)],
            [number for number in _ignored() if not (restore_signals and number in (signal.SIGPIPE, signal.SIGXFSZ))],
            _blocked(), bool(start_new_session), process_group, old_mask if umask < 0 else umask,
        )  # fmt: skip
        sys.audit("subprocess.Popen", words[0], words, cwd, env)  # as the original does: `tests.tiers` listens
        pid = self._ask(request, descriptors)
        if pid is None:
            return False
        process.pid, process._child_created = pid, True
        process._close_pipe_fds(p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite)
        return True

    def _spawn(self, args: Sequence[Any], passed: list[int]) -> int | None:
        """Start a child of `multiprocessing` warm; return None, with nothing done, where it has to start cold."""
        words, environment = [os.fsdecode(word) for word in args], dict(os.environ)
        program = _program(words, os.getcwd(), bool(environment.get(SAFE_PATH)))
        if words[-1] != _SHARES_WORK or program is None or _read_at_import(environment) != self._environment:
            return None
        old_mask = os.umask(0)
        os.umask(old_mask)
        numbers = sorted({0, 1, 2, *passed})
        request = fork_server.Request(
            program, os.getcwd(), environment, numbers, _ignored(), _blocked(), False, -1, old_mask
        )
        return self._ask(request, numbers)

    def _ask(self, request: fork_server.Request, descriptors: list[int]) -> int | None:
        """Return the process id of a new child; None where there is no fork server any more."""
        with self._lock:
            if self._line is None and not self._start():
                return None
            assert self._line is not None
            try:
                fork_server.send(self._line, request, descriptors)
                answer = fork_server.receive(self._line)
            except OSError:  # one descriptor is closed here, or the fork server has ended: cold then
                answer = None
            if answer is None:
                self._line.close()
                self._line = None
                return None
            self.started += 1
            return int(answer[0])

    def _start(self) -> bool:
        if not fork_server.can_fork() or self._server is not None:
            return False
        ours, theirs = socket.socketpair()
        with theirs:
            self._server = _cold(
                self._before,
                [sys.executable, fork_server.__file__, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
            )
            LASTING.add(self._server.pid)
        if fork_server.receive(ours) is None:
            ours.close()
            return False
        self._line = ours
        return True


def _cold(execute: Any, arguments: list[str], pass_fds: tuple[int, ...]) -> subprocess.Popen[bytes]:
    class Cold(subprocess.Popen[bytes]):
        _execute_child = execute

    return Cold(arguments, pass_fds=pass_fds, stdin=subprocess.DEVNULL)


def _ignored() -> list[int]:
    return [number for number in signal.valid_signals() if signal.getsignal(number) == signal.SIG_IGN]


def _blocked() -> list[int]:
    return [int(number) for number in signal.pthread_sigmask(signal.SIG_BLOCK, ())]


def _program(words: list[str], folder: str, is_safe: bool) -> list[str] | None:
    """Return the words behind the interpreter of a child that may start warm.

    Args:
        is_safe: The interpreter adds no folder to its path.
    """
    if not words or words[0] != sys.executable:
        return None
    rest = words[1:]
    if rest and rest[0] == "-P":
        rest, is_safe = rest[1:], True
    if len(rest) < 2 or rest[0] not in ("-m", "-c"):
        return None
    if rest[0] == "-m" and not any(rest[1] == name or rest[1].startswith(name) for name in WARM_MODULES):
        return None
    return rest if is_safe or _shadows_nothing(folder) else None


def _shadows_nothing(folder: str) -> bool:
    """Whether a module of this folder, which the interpreter puts first, hides none that is imported already."""
    if Path(folder) == ROOT:
        return True
    here = Path(folder)
    return not any(here.glob("*.py")) and not any(here.glob("*/__init__.py"))


def _read_at_import(environment: Any) -> dict[str, str]:
    return {
        name: value
        for name, value in environment.items()
        if name.startswith(_READ_AT_IMPORT) and name != SAFE_PATH and (name, value) != _DRAWS_NOTHING
    }
