"""A network namespace whose loopback carries multicast as LCM's own library asks for it: that refuses a bare one."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.network_link import enter

_SET_UP = (
    "ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo && echo ready && exec cat"
)


@contextlib.contextmanager
def multicast_loopback() -> Iterator[tuple[str, ...]]:
    """Give what a command line begins with, so that it runs there; a machine that makes none skips, CI fails."""
    lacking = [name for name in ("unshare", "ip") if shutil.which(name) is None]
    if lacking:
        _do_without(f"there is no {' or '.join(lacking)}")
    with subprocess.Popen(
        ["unshare", "--net", "sh", "-c", _SET_UP], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    ) as holder:  # fmt: skip
        assert holder.stdin is not None
        assert holder.stdout is not None
        assert holder.stderr is not None
        if holder.stdout.readline() != "ready\n":
            _do_without(holder.stderr.read().strip())
        yield (sys.executable, "-I", "-S", enter.__file__, f"/proc/{holder.pid}/ns/net")
        holder.stdin.close()


def _do_without(why: str) -> None:
    message = f"no network namespace with multicast on its loopback, which needs root: {why}"
    (pytest.fail if os.environ.get("CI") else pytest.skip)(message)
