"""`station bus start --bulk` as a person types it."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from station.bus import address as addresses
from station.bus import keys
from station.bus.address import bulk_beside, bulk_of
from station.bus.client import Bus
from station.bus.discovery import found_or_started
from tests.waiting import bus_answers, wait_until

pytestmark = pytest.mark.usefixtures("processes")


def station(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "station", *arguments], capture_output=True, text=True, timeout=60, check=False
    )


@contextlib.contextmanager
def started(*arguments: str) -> Iterator[list[str]]:
    """Run `station bus start` until the block ends; gives what it has printed."""
    process = subprocess.Popen(
        [sys.executable, "-m", "station", "bus", "start", *arguments], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    printed = []
    try:
        for line in process.stdout:
            printed.append(line.rstrip("\n"))
            if line.startswith("Ctrl-C"):
                break
        yield printed
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        process.stdout.close()


def test_both_are_started_found_told_of_and_stopped() -> None:
    with started("--bulk") as printed:
        own = addresses.own()
        bulk = bulk_of(own)
        assert bulk is not None
        assert bus_answers(bulk)
        assert re.fullmatch(rf"bulk bus {re.escape(str(bulk))} \(pid \d+\): depth and clouds of .*", printed[1])
        assert printed[-1] == "Ctrl-C stops both"
        assert f"bulk_address                   {bulk}" in station("bus", "info").stdout
        assert f"✓ bulk bus: {bulk}" in station("doctor").stdout
        again = station("bus", "start", "--bulk")
        assert again.returncode == 1
        assert again.stderr.count("\n") == 1
    assert not bus_answers(own)
    assert not Path(str(bulk.socket)).exists()


def test_the_second_is_added_to_a_bus_that_runs_with_its_password(monkeypatch: pytest.MonkeyPatch) -> None:
    port = str(20_000 + os.getpid() % 10_000)
    with started("--bind", "127.0.0.1", "--tcp", port), started("--bulk") as printed:
        assert len(printed) == 2, printed
        with Bus(name="head", timeout_s=1.0) as line:
            assert line.address.password
            assert line.publish({keys.camera_depth("head"): b"png"})
            assert line.open_bulk().address != line.address
            assert line.names("camera_*") == [keys.camera_depth("head")]


def test_the_second_is_not_added_under_servers_that_run() -> None:
    with started(), Bus(name="cli", timeout_s=1.0):
        recorder = subprocess.Popen(
            [sys.executable, "-m", "station", "serve", "recorder"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
        try:
            with Bus(name="test", timeout_s=1.0) as line:
                wait_until(lambda: line.get(keys.server("recorder")))
            refused = station("bus", "start", "--bulk")
            assert refused.returncode == 1
            assert re.fullmatch(
                r"station: bus \S+: recorder would go on without a bulk bus, .*`station down`.*\n", refused.stderr
            )
        finally:
            recorder.terminate()
            recorder.wait(20)


def test_one_that_was_killed_is_there_again_and_one_whose_terminal_was_killed_is_forgotten() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "station", "bus", "start", "--bulk"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        pids = [int(found[1]) for line in (process.stdout.readline(), process.stdout.readline())
                if (found := re.search(r"pid (\d+)", line))]  # fmt: skip
        own = addresses.own()
        bulk = bulk_of(own)
        assert bulk is not None
        with Bus(own, name="head", timeout_s=1.0) as line:
            assert line.publish({keys.lidar_cloud("top"): b"cloud"})
            os.kill(pids[1], signal.SIGKILL)
            wait_until(lambda: line.publish({keys.lidar_cloud("top"): b"cloud"}) and line.open_bulk().connections > 1)
            assert line.connections == 1
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    wait_until(lambda: not bus_answers(own) and not bus_answers(bulk))
    assert bulk_beside(str(own.socket)).exists()
    with found_or_started(None) as address:
        assert bulk_of(address) is None
