"""The guard is built as its README says, and says in one line what is wrong with how it is started."""

from __future__ import annotations

import socket
import subprocess

import pytest

from tests.adapters.robots.g1.dds.test_wire import HASHES


def run(program, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, *words], capture_output=True, text=True, timeout=60, check=False)


def test_its_types_have_the_hashes_that_the_robot_knows(plain):
    pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")
    code = plain.read_bytes()
    for kind, hashes in HASHES.items():
        if kind.__name__ in ("LowCmd_", "LowState_"):
            assert all(bytes.fromhex(each) in code for each in hashes)


@pytest.mark.parametrize(("words", "said"), [
    (["--nosuch"], "there is no option '--nosuch'"),
    (["-x"], "there is no option '-x'"),
    (["--port"], "a value is missing after '--port'"),
    (["--port", "70000"], "expected a number from 1 to 65535"),
    (["--port", "0"], "expected a number from 1 to 65535"),
    (["--domain", "-1"], "expected a number from 0 to 230"),
    (["--domain", ""], "expected a number from 0 to 230"),
    (["armed"], "unexpected 'armed'"),
])  # fmt: skip
def test_a_wrong_option_is_named_in_a_line(plain, words, said):
    done = run(plain, *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert done.stderr.count("\n") == 1


def test_help_lists_every_option(plain):
    done = run(plain, "--help")
    assert done.returncode == 0
    assert all(f"--{name}" in done.stdout for name in ("interface", "domain", "bind", "port", "armed-flag", "help"))


@pytest.mark.parametrize(("words", "said"), [
    (["--interface", "nosuch0"], "interface 'nosuch0': there is none of this name"),
    (["--bind", "localhost"], "--bind 'localhost': expected an IPv4 address"),
    (["--bind", "203.0.113.9"], "203.0.113.9 port 47029"),
    (["--armed-flag", "/nosuch/armed"], "--armed-flag '/nosuch/armed': No such file"),
])  # fmt: skip
def test_what_cannot_be_used_is_named_in_a_line(plain, words, said):
    done = run(plain, *words)
    lines = [line for line in done.stderr.splitlines() if "refused" not in line and "not locked" not in line]
    assert (done.returncode, len(lines)) == (1, 1)
    assert said in lines[0]


def test_a_port_that_is_in_use_is_named_in_a_line(plain):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        done = run(plain, "--port", str(port))
    assert done.returncode == 1
    assert f"127.0.0.1 port {port}: Address already in use; another guard?" in done.stderr
    assert done.stderr.count("\n") == 1
