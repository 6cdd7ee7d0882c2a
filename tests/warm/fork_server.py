"""The fork server: imports everything once, then forks a child for each request of `warm.starts`. Run as a script.

A forked child is a child of the process that asked, not of this one (CLONE_PARENT): it can be waited for, killed and
frozen as if it had been started cold. Nothing but imports happens before the fork: no session, no thread, no file.
"""

from __future__ import annotations

import array
import atexit
import ctypes
import gc
import importlib
import io
import json
import os
import platform
import resource
import runpy
import signal
import socket
import sys
import threading
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

PRELOADED = (
    "station", "numpy", "mujoco", "onnxruntime", "mcap.writer", "mcap.reader", "msgspec.json", "rich.console",
    "rich.live", "station.cli.main", "station.supervision.session", "station.rehearse",
)  # fmt: skip
"""Imported beside all servers, verbs and what the entry points of the station name, as far as it is installed."""

STARTS_CHILDREN = ("up", "demo", "rehearse", "export", "retarget", "import", "compact")
"""Verbs of `station` whose process starts servers, or processes to share its work: it gets a fork server of its own."""

_PR_GET_TID_ADDRESS = 40
_SYS_CLONE = {"x86_64": 56, "aarch64": 220}
_CLONE_PARENT, _CLONE_CHILD_CLEARTID, _CLONE_CHILD_SETTID = 0x00008000, 0x00200000, 0x01000000
_LOST_OUTPUT = 120  # the interpreter's exit status where a stream could not be flushed
_HEADER = 4
_MOST_DESCRIPTORS = 64


class Request(NamedTuple):
    """What a child is to become."""

    arguments: list[str]
    """Behind the interpreter: ``-m MODULE …`` or ``-c CODE …``."""
    folder: str
    environment: dict[str, str]
    descriptors: list[int]
    """Numbers that the descriptors, sent along, have in the child."""
    ignored: list[int]
    """Signals that the child ignores."""
    blocked: list[int]
    """Signals that the thread which starts the child has blocked, as the child's first thread then has."""
    new_session: bool
    process_group: int
    umask: int


def can_fork() -> bool:
    """Whether this machine can fork a child for its parent."""
    return sys.platform == "linux" and platform.machine() in _SYS_CLONE and _thread_id_address() is not None


def send(line: socket.socket, message: Any, descriptors: list[int]) -> None:
    """Send one message, with descriptors."""
    data = json.dumps(message).encode()
    data = len(data).to_bytes(_HEADER, "little") + data
    sent = line.sendmsg([data], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", descriptors))])
    line.sendall(data[sent:])


def receive(line: socket.socket) -> tuple[Any, list[int]] | None:
    """Receive one message, with descriptors; None at the end."""
    data, ancillary, _, _ = line.recvmsg(1 << 16, socket.CMSG_SPACE(_MOST_DESCRIPTORS * 4))
    if not data:
        return None
    found = array.array("i")
    for _, _, packed in ancillary:
        found.frombytes(packed[: len(packed) - len(packed) % found.itemsize])
    while len(data) < _HEADER or len(data) < _HEADER + int.from_bytes(data[:_HEADER], "little"):
        data += line.recv(1 << 20)
    return json.loads(data[_HEADER:]), list(found)


def serve(line: socket.socket) -> tuple[Request, list[int]] | None:
    """Fork a child for each request; return None at the end of the line, and the request in each child."""
    while (asked := receive(line)) is not None:
        request, descriptors = Request(*asked[0]), asked[1]
        _check_single_thread()
        pid = _fork_for_parent()
        if pid == 0:
            line.close()
            return request, descriptors
        for descriptor in descriptors:
            os.close(descriptor)
        send(line, pid, [])
    return None


def become(request: Request, descriptors: list[int]) -> None:
    """Turn this child into what was asked for; return when it has ended, or raise what ended it."""
    _take_descriptors(request.descriptors, descriptors)
    os.umask(request.umask)
    if request.new_session:
        os.setsid()
    if request.process_group >= 0:
        os.setpgid(0, request.process_group)
    _reset_signals(set(request.ignored), request.blocked)
    os.chdir(request.folder)
    os.environ.clear()
    os.environ.update(request.environment)
    _open_standard_streams()
    if "COVERAGE_PROCESS_START" in os.environ:
        importlib.import_module("coverage").process_startup()
    option, subject, *rest = request.arguments
    if option == "-m" and subject == "station" and rest and rest[0] in STARTS_CHILDREN:
        _serve_own_children()
    if option == "-m":
        sys.argv = [subject, *rest]
        runpy._run_module_as_main(subject)  # type: ignore[attr-defined]  # as the interpreter itself does it
    else:
        sys.argv = ["-c", *rest]
        own = sys.modules["__main__"].__dict__
        for name in [name for name in own if not name.startswith("__")]:
            del own[name]
        exec(compile(subject, "<string>", "exec"), own)


def run(request: Request, descriptors: list[int]) -> NoReturn:
    """Become what was asked for, and end as an interpreter does, but free nothing: of all memory that is shared with
    the fork server a copy would be made first (50 ms of a processor for a child that does nothing)."""
    code, is_interrupted = 0, False
    try:
        become(request, descriptors)
    except SystemExit as error:
        code = _exit_code(error)
    except BaseException as error:  # noqa: BLE001  it is told as an interpreter tells it
        sys.excepthook(type(error), error, error.__traceback__)
        code, is_interrupted = 1, isinstance(error, KeyboardInterrupt)
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            code = _LOST_OUTPUT
    if is_interrupted:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    os._exit(code)


def _exit_code(ended: SystemExit) -> int:
    """Return the exit status that an interpreter makes of what `sys.exit` was given."""
    if ended.code is None or isinstance(ended.code, int):
        return (ended.code or 0) & 0xFF
    sys.stderr.write(f"{ended.code}\n")
    return 1


def preload() -> None:
    """Import what the children need."""
    for name in PRELOADED:
        importlib.import_module(name)
    from station import registry
    from station.cli import main

    for verb in main.VERBS:
        importlib.import_module(main.module_of(verb))
    for kind in ("server", "robot", "policy", "command", "motion", "driver"):
        for name in registry.names(kind):
            registry.find(kind, name)


def _fork_for_parent() -> int:
    """Fork a sibling of this process; return 0 in it, else its process id."""
    python, address = ctypes.PyDLL(None, use_errno=True), _thread_id_address()
    machine = platform.machine()
    flags = _CLONE_PARENT | _CLONE_CHILD_SETTID | _CLONE_CHILD_CLEARTID | signal.SIGCHLD
    thread = (address, None) if machine == "x86_64" else (None, address)  # the order of the last two differs
    python.PyOS_BeforeFork()
    pid: int = python.syscall(
        *(ctypes.c_long(word) for word in (_SYS_CLONE[machine], flags, 0, 0)), *map(ctypes.c_void_p, thread)
    )
    if pid == 0:
        python.PyOS_AfterFork_Child()
    else:
        python.PyOS_AfterFork_Parent()
    if pid < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return pid


def _thread_id_address() -> int | None:
    """Where the C library keeps the id of its main thread, which it sets anew in a forked child."""
    found = ctypes.c_void_p()
    failed = ctypes.CDLL(None).prctl(_PR_GET_TID_ADDRESS, ctypes.byref(found), 0, 0, 0)
    return None if failed else found.value


def _check_single_thread() -> None:
    """See that no thread is lost by a fork; the fork handlers of a library end its idle ones."""
    if len(os.listdir("/proc/self/task")) > 1:
        if (pid := os.fork()) == 0:
            os._exit(0)
        os.waitpid(pid, 0)
    if len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("an import of the fork server has started a thread")


def _take_descriptors(numbers: list[int], descriptors: list[int]) -> None:
    """Give the descriptors their numbers, and close all others."""
    above = max([*numbers, *descriptors, 2]) + 1
    moved = []
    for descriptor in descriptors:
        above = os.dup2(descriptor, above) + 1
        moved.append(above - 1)
    for number, descriptor in zip(numbers, moved, strict=True):
        os.dup2(descriptor, number, inheritable=True)
    kept = sorted({*numbers})
    for low, high in zip([-1, *kept], [*kept, _descriptor_limit()], strict=True):
        if low + 1 < high:  # (0, 0) would close all of them
            os.closerange(low + 1, high)


def _descriptor_limit() -> int:
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def _reset_signals(ignored: set[int], blocked: list[int]) -> None:
    """Set the signals as in an interpreter that has just started."""
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        if signal.getsignal(number) is not None:
            signal.signal(number, signal.SIG_IGN if number in ignored else signal.SIG_DFL)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):
        signal.signal(number, signal.SIG_IGN)
    if signal.SIGINT not in ignored:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)  # what came since the fork is delivered now


def _open_standard_streams() -> None:
    """Open the three streams on the descriptors that are here now."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        before = getattr(sys, f"__{name}__")
        buffering = 0 if number and before.write_through else -1  # PYTHONUNBUFFERED
        raw = open(number, "wb" if number else "rb", buffering, closefd=False)  # noqa: SIM115  as long as the process
        stream = io.TextIOWrapper(
            raw, encoding=before.encoding, errors=before.errors, newline="\n" if number else None,
            line_buffering=number == 2 or os.isatty(number), write_through=not buffering,
        )  # fmt: skip
        stream.mode = "w" if number else "r"  # type: ignore[misc]
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


def _serve_own_children() -> None:
    """Leave a fork server to this process, as young as it is now, for the children that it will start."""
    ours, theirs = socket.socketpair()
    if os.fork() == 0:
        descriptor = os.dup2(theirs.fileno(), 3)
        os.closerange(0, 3)
        os.closerange(4, _descriptor_limit())
        _block_terminal()
        child = serve(socket.socket(fileno=descriptor))
        if child is None:
            os._exit(0)
        run(*child)
    theirs.close()
    from tests.warm.starts import WarmStarts

    WarmStarts(ours).install()


def _block_terminal() -> None:
    """Outlive what is meant for others. Not by ignoring it: a child that is asked to stop right after its fork, before
    it has handlers of its own, would never know."""
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGQUIT))


def main() -> None:
    """Serve on the socket whose descriptor is the only argument."""
    line = socket.socket(fileno=int(sys.argv[1]))
    preload()
    gc.collect()
    gc.freeze()
    _block_terminal()
    send(line, os.getpid(), [])
    child = serve(line)
    if child is not None:
        run(*child)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))
    importlib.import_module("tests.warm.fork_server").main()  # not this module: a child takes its place
