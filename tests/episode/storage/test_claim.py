from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from station import lock_file
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.storage.claim import Claim, is_claimed
from station.errors import EpisodeError, Refused
from tests.waiting import DEADLINE_S

HOLD = """
import signal, sys
from pathlib import Path
from station.bus.address import parse
from station.bus.client import Bus
from station.episode.storage.claim import Claim
claim = Claim(Path(sys.argv[1]), Bus(parse(sys.argv[2]), name="first", timeout_s=5.0))
print("held", flush=True)
signal.pause()
"""


def test_one_recorder_per_data_folder_until_it_is_killed(bus_server: BusAddress, tmp_path: Path) -> None:
    with (
        Bus(bus_server, name="second", timeout_s=5.0) as bus,
        subprocess.Popen(
            [sys.executable, "-c", HOLD, str(tmp_path), bus_server.url], stdout=subprocess.PIPE, text=True
        ) as first,
    ):
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        assert is_claimed(tmp_path)
        with pytest.raises(Refused, match=rf"data folder .*another recorder \(pid {first.pid}\).*--data") as caught:
            Claim(tmp_path, bus)
        assert "\n" not in str(caught.value)
        with pytest.raises(Refused, match=rf"bus .*another recorder \(pid {first.pid}\)"):
            Claim(tmp_path / "other", bus)
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
        assert not is_claimed(tmp_path)
        Claim(tmp_path, bus).close()


def test_a_recorder_of_another_machine_is_heard_on_the_bus(bus_server: BusAddress, tmp_path: Path) -> None:
    with (
        Bus(bus_server, name="far-recorder", timeout_s=5.0) as far,
        Bus(bus_server, name="second", timeout_s=5.0) as bus,
    ):
        far.publish({keys.RECORDER: b'{"state": "idle"}'})
        Claim(tmp_path, bus).close()  # it said so once, long ago as far as we know, and says no more
        done = threading.Event()

        def speak() -> None:
            while not done.wait(0.1):
                far.publish({keys.RECORDER: b'{"state": "idle"}'})

        thread = threading.Thread(target=speak)
        thread.start()
        try:
            with pytest.raises(Refused, match=r"another recorder \(far-recorder\."):
                Claim(tmp_path, bus)
        finally:
            done.set()
            thread.join()


def test_a_data_folder_that_cannot_be_made_is_refused(bus_server: BusAddress, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with Bus(bus_server, name="recorder") as bus, pytest.raises(EpisodeError, match=r"cannot be made.*--data"):
        Claim(tmp_path / "file" / "data", bus)


def test_looking_at_the_lock_does_not_keep_a_recorder_out(
    bus_server: BusAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock_file, "_TRIES", round(DEADLINE_S / lock_file._TRY_S))
    done = threading.Event()

    def look() -> None:
        while not done.is_set():
            is_claimed(tmp_path)
            time.sleep(0.0005)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        with Bus(bus_server, name="recorder", timeout_s=5.0) as bus:
            for _ in range(50):
                Claim(tmp_path, bus).close()
    finally:
        done.set()
        thread.join()


def test_a_folder_that_was_removed_or_replaced_is_claimed_anew(bus_server: BusAddress, tmp_path: Path) -> None:
    data = tmp_path / "data"
    with Bus(bus_server, name="recorder", timeout_s=5.0) as bus, Claim(data, bus) as claim:
        claim.renew()
        assert is_claimed(data)
        data.rename(tmp_path / "elsewhere")
        assert not is_claimed(data)
        claim.renew()
        assert is_claimed(data)
        assert not is_claimed(tmp_path / "elsewhere")
        with pytest.raises(Refused, match=r"data folder .*another recorder"):
            Claim(data, bus)


def test_a_folder_that_another_recorder_has_claimed_meanwhile_is_refused_until_it_lets_go(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    data = tmp_path / "data"
    with Bus(bus_server, name="recorder", timeout_s=5.0) as bus, Claim(data, bus) as claim:
        data.rename(tmp_path / "elsewhere")
        data.mkdir()
        with (data / ".recorder.lock").open("w") as other:
            fcntl.flock(other, fcntl.LOCK_EX)
            with pytest.raises(Refused, match=r"data folder .*another recorder"):
                claim.renew()
            assert is_claimed(tmp_path / "elsewhere")
        claim.renew()
        assert is_claimed(data)
