"""A stranger's first day: the wheel in an empty folder, no privileges, no display, 60 columns, Latin-1, no docs read.

Each command line ends with the exit code that its help or docs give, shows no traceback, says something at least every
ten seconds, and leaves no process behind.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import wheels
from tests.cli.running import Home, new_home
from tests.cli.wrong_inputs import BARE
from tests.figures import Figures
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.timeout(1800)

LONGEST_SILENCE_S = 10.0
UNPRIVILEGED = ("setpriv", "--bounding-set=-all", "--inh-caps=-all")
"""As root: without the right to write what its modes protect."""

LOOK_AROUND = """
0 --version
0 --help
0 docs
0 docs first-episode
2 docs nothing
0 runbooks list
0 runbooks show g1-demo
0 runbooks copy g1-demo
2 runbooks copy g1-demo
2 runbooks show g1-dmo
0 settings
0 settings g1
2 settings g7
0 motions
0 motions --formats
1 motions nowhere.npz
0 keys
0 devices list
0 devices buttons
0 assets list
0 assets where builtin:g1.xml
0 completion bash
0 init lab
2 init lab
1 status
1 status --json
1 doctor
1 estop
0 estop --reset
1 arm
0 down
1 logs
1 record start
0 episodes list
2 check latest
2 check
2 chekc
2 up
2 up g1-dmo
0 up g1-demo --dry-run
2 up g1-demo --set g1.rate_hz=-5
1 up g1-sim-motion
2 serve
2 serve g7
"""
"""Exit code and words of each command line, in order; nothing has been recorded and no station runs."""

DRIVE = """
0 demo
0 up g1-sim-motion --yes --record --task walk --for 5s
0 rehearse builtin:wave
"""

LOOK_AT_EPISODES = """
0 episodes list
0 episodes show latest
0 check latest
0 check latest --json
0 check latest --all
0 audit latest
1 view latest
0 view latest --save latest.rrd
0 view latest --contact-sheet --plot
0 export lerobot --dry-run --out dataset
0 export lerobot --out dataset
2 export lerobot --out dataset
0 export csv --out tables
0 export npz --out arrays
0 report latest --out page.html
0 enrich latest
2 replay latest
0 replay latest --to sim
0 episodes repair --all
1 episodes repair nothing
"""

BESIDE_A_STATION = """
0 status
0 status --json
0 doctor
0 keys
0 describe
0 record mark here
0 record stop
0 record start --task second
0 record discard
0 disarm
0 arm
0 logs
1 up g1-sim-motion --yes
0 down
"""

STOP = """
0 estop
1 up g1-demo --yes
1 demo
0 estop --reset
"""

READ_ONLY = """
1 up g1-sim-motion --yes --record --task walk
1 demo
2 init another
2 export csv --out others
1 check latest
"""
"""The newest episode is that of the stop: rejected, though its report cannot be kept."""


@pytest.fixture
def home(processes: None, tmp_path: Path) -> Iterator[Home]:
    python = wheels.install(wheels.build(tmp_path), tmp_path / "env")
    with new_home() as made:
        wheels.use(made, python)
        made.environment |= BARE | {"HOME": str(tmp_path / "user"), "STATION_ASSETS": ""}
        yield made


class Day:
    """What is typed, and what is wrong with how it was answered.

    Attributes:
        typed: How many command lines.
        wrong: Those that were not answered as they should be, with the end of what they said.
    """

    def __init__(self, home: Home, folder: Path) -> None:
        self._home, self._folder = home, folder
        self._before = UNPRIVILEGED if os.geteuid() == 0 else ()
        self.typed, self.wrong = 0, list[str]()

    def start(self, *words: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*self._before, "station", *words], cwd=self._folder, env=self._home.environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="latin-1",
        )  # fmt: skip

    def type(self, lines: str) -> None:
        for line in lines.strip().splitlines():
            code, *words = line.split()
            self._type(int(code), words)

    def _type(self, code: int, words: list[str]) -> None:
        self.typed += 1
        spoken_s, said = [time.monotonic()], list[str]()
        process = self.start(*words)

        def read() -> None:
            assert process.stdout is not None
            while text := os.read(process.stdout.fileno(), 1 << 16):
                spoken_s.append(time.monotonic())
                said.append(text.decode("latin-1"))

        reader = threading.Thread(target=read)
        reader.start()
        is_silent = False
        while process.poll() is None and not is_silent:
            is_silent = time.monotonic() - spoken_s[-1] > LONGEST_SILENCE_S
            time.sleep(0.02)
        process.kill()
        process.wait()
        reader.join()
        assert process.stdout is not None
        process.stdout.close()
        text, line = "".join(said), f"station {' '.join(words)}"
        if is_silent:
            self.wrong.append(f"{line}: says nothing for {LONGEST_SILENCE_S:g} s: {text[-500:]}")
        elif process.returncode != code:
            self.wrong.append(f"{line}: exit code {process.returncode}, not {code}: {text[-500:]}")
        elif "Traceback" in text:
            self.wrong.append(f"{line}: {text[-2000:]}")
        elif code and not text.strip():
            self.wrong.append(f"{line}: fails and says nothing")


@contextlib.contextmanager
def station_up(day: Day, home: Home) -> Iterator[subprocess.Popen[str]]:
    """Run a station in another terminal for the length of a block."""
    with day.start("up", "g1-sim-motion", "--yes", "--record", "--set", "motion.loop=true") as station:
        try:
            wait_until(lambda: home.bus_is_there() and is_active(home, "motion"))
            yield station
        finally:
            station.kill()
            assert not day.wrong, "\n".join(day.wrong)


def is_active(home: Home, server: str) -> bool:
    health = home.health().get(server)
    return health is not None and health.state == "active"


def orphans(home: Home) -> list[str]:
    """Return the command lines of processes that were started from a home and still run."""
    found, mark = [], home.environment["XDG_RUNTIME_DIR"].encode()
    for process in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if process.name.isdigit() and mark in (process / "environ").read_bytes():
                found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"))
    return found


def test_of_a_first_day_no_command_hangs_shows_a_traceback_or_leaves_a_process(
    home: Home, tmp_path: Path, proof: Figures
) -> None:
    if os.geteuid() == 0 and shutil.which("setpriv") is None:
        pytest.skip("as root, setpriv is needed to be an ordinary user")
    (tmp_path / "user").mkdir()
    folder = tmp_path / "empty"
    folder.mkdir()
    day = Day(home, folder)
    day.type(LOOK_AROUND)
    day.type(DRIVE)
    day.type(LOOK_AT_EPISODES)
    with station_up(day, home) as station:
        day.type(BESIDE_A_STATION)
        assert station.wait(DEADLINE_S) == 0
    with station_up(day, home) as station:
        day.type(STOP)
        assert station.wait(DEADLINE_S) == 1, "its motion ended with the stop"
    for path in (folder, home.data):
        path.chmod(0o555)
    day.type(READ_ONLY)
    for path in (folder, home.data):
        path.chmod(0o755)
    wait_until(lambda: not orphans(home))
    assert not day.wrong, "\n".join(day.wrong)
    proof.figure("command lines of a first day that hang, show a traceback or end in a wrong exit code", 0,
                 limit=f"0 of {day.typed}")  # fmt: skip
    proof.figure("processes that a first day leaves behind", 0, limit="0")
