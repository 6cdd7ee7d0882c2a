"""Rerun's viewer as a process of ours; here it is Rerun's own server without a window, so no test needs a display."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun_cli

from station.episode.reading.reader import open_episode
from station.errors import StationError
from station.view import viewer as viewers
from station.view.episode_rrd import show
from station.view.viewer import BINARY_VARIABLE, open_viewer
from tests.cli.running import are_gone
from tests.episode.synthetic import EpisodeBuilder, walk
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")

SERVER = f'exec "{Path(rerun_cli.__file__).with_name("rerun")}" --serve-grpc "$@"'


class Program:
    """A program in the place of the viewer."""

    def __init__(self, folder: Path) -> None:
        self.path, self._pid_file = folder / "viewer", folder / "pid"

    def write(self, script: str) -> None:
        self.path.write_text(f'#!/bin/sh\necho $$ > "{self._pid_file}"\n{script}\n')
        self.path.chmod(0o755)

    @property
    def pid(self) -> int:
        return int(self._pid_file.read_text())

    def kill(self) -> None:
        if self._pid_file.exists() and not are_gone([self.pid]):
            os.kill(self.pid, signal.SIGKILL)


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Program]:
    made = Program(tmp_path)
    made.write(SERVER)
    monkeypatch.setenv(BINARY_VARIABLE, str(made.path))
    monkeypatch.setenv("DISPLAY", ":0")  # never connected to
    yield made
    made.kill()


@pytest.fixture
def recording() -> rr.RecordingStream:
    return rr.RecordingStream("test")


def listening_addresses(pid: int) -> set[str]:
    """Addresses [hexadecimal, as the kernel writes them] that a process listens on."""
    mine = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed since
            mine.add(os.readlink(link))
    lines = [line.split() for table in ("tcp", "tcp6") for line in Path(f"/proc/net/{table}").read_text().splitlines()]
    return {line[1].split(":")[0] for line in lines if line[3] == "0A" and f"socket:[{line[9]}]" in mine}


@pytest.mark.parametrize("variable", ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"])
def test_without_a_display_nothing_is_started_and_the_error_says_what_to_do(
    program: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, "")
    builder = EpisodeBuilder(tmp_path / "data")
    walk(builder, seconds=0.2)
    with pytest.raises(StationError, match=r"^no display .* --save FILE\.rrd .* --contact-sheet --plot"):
        show(open_episode(builder.finish()))
    assert not (tmp_path / "pid").exists()


def test_a_viewer_listens_on_loopback_alone_and_goes_on_when_it_has_the_episode(
    program: Program, tmp_path: Path
) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    walk(builder, seconds=0.2)
    assert show(open_episode(builder.finish())).path is None
    assert listening_addresses(program.pid) == {socket.inet_aton("127.0.0.1")[::-1].hex().upper()}


def test_a_viewer_that_does_not_start_is_an_error_with_its_last_words(
    program: Program, recording: rr.RecordingStream
) -> None:
    program.write("echo 'INFO listening'; printf '\\033[31mError: no adapter\\033[0m\\n' >&2; exit 3")
    with (
        pytest.raises(StationError, match=r"ended \(exit code 3: no adapter\); --save FILE"),
        open_viewer(recording),
    ):
        raise AssertionError("it is not there")


def test_a_viewer_that_cannot_be_run_is_an_error(program: Program, recording: rr.RecordingStream) -> None:
    program.path.unlink()
    with (
        pytest.raises(StationError, match="viewer: Rerun's viewer cannot be started: No such file"),
        open_viewer(recording),
    ):
        raise AssertionError("it is not there")


def test_a_viewer_that_dies_before_it_has_everything_is_an_error_and_not_waited_for(
    program: Program, recording: rr.RecordingStream
) -> None:
    ended = threading.Event()
    with open_viewer(recording, on_end=ended.set) as viewer:
        program.kill()
        assert ended.wait(DEADLINE_S)
        recording.log("text", rr.TextLog("never seen"))
        with pytest.raises(StationError, match=r"ended \(signal SIGKILL\); --save FILE"):
            viewer.deliver(recording)


def test_a_viewer_that_is_frozen_is_not_waited_for_without_end(
    program: Program, recording: rr.RecordingStream, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewers, "_DELIVERY_S", 0.5)
    much = np.random.default_rng(0).integers(0, 255, 16_000_000, dtype=np.uint8)

    def show_to_a_frozen_viewer() -> None:
        with open_viewer(recording) as viewer:
            os.kill(program.pid, signal.SIGSTOP)
            for number in range(5):  # more than a socket and Rerun's own queue hold
                recording.log(f"numbers{number}", rr.Tensor(much))
            viewer.deliver(recording)

    with pytest.raises(StationError, match="did not take all data within"):
        show_to_a_frozen_viewer()
    assert are_gone([program.pid])


def test_an_interrupt_ends_the_viewer(program: Program, recording: rr.RecordingStream) -> None:
    with pytest.raises(KeyboardInterrupt), open_viewer(recording):
        raise KeyboardInterrupt
    assert are_gone([program.pid])


def test_who_looks_at_a_running_station_is_told_when_the_viewer_ends(
    program: Program, recording: rr.RecordingStream
) -> None:
    ended = threading.Event()
    with open_viewer(recording, on_end=ended.set) as viewer:
        assert not ended.is_set()
        program.kill()
        assert ended.wait(DEADLINE_S)
        assert not viewer.is_closed


def test_a_window_that_was_closed_is_known(program: Program, recording: rr.RecordingStream) -> None:
    program.write(f"trap 'kill $server; exit 0' TERM; ({SERVER}) & server=$!; wait")
    with open_viewer(recording) as viewer:
        assert not viewer.is_closed
        os.kill(program.pid, signal.SIGTERM)
        wait_until(lambda: viewer.is_closed)
