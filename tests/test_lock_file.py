"""Lock files say who has them; a dead process has none."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from station import lock_file

HOLD = """
import sys, time
from pathlib import Path
from station import lock_file
lock_file.take(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(600)
"""


@pytest.mark.usefixtures("processes")
def test_one_has_it_until_it_dies_and_the_next_is_told_who_had_it(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    assert (lock_file.holder(path), lock_file.is_locked(path)) == (None, False)
    with subprocess.Popen([sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout is not None
            assert other.stdout.readline() == "held\n"
            assert (lock_file.holder(path), lock_file.is_locked(path)) == (str(other.pid), True)
            with pytest.raises(lock_file.Held) as held:
                lock_file.take(path)
            assert held.value.holder == str(other.pid)
        finally:
            other.kill()
    assert lock_file.holder(path) is None
    descriptor, before = lock_file.take(path)
    assert (before, lock_file.holder(path)) == (str(other.pid), str(os.getpid()))
    os.close(descriptor)
    assert not lock_file.is_locked(path)


@pytest.mark.parametrize("text", [b"", b"nobody", b"-1", "٣".encode(), b"\xff\x00"])
def test_what_is_no_process_id_names_nobody(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "a.lock"
    descriptor, _ = lock_file.take(path)
    path.write_bytes(text)
    assert lock_file.holder(path) == ""
    os.close(descriptor)


def test_a_pipe_is_nobodys_lock_and_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    os.mkfifo(path)
    assert lock_file.holder(path) is None
