"""The whole station as a user runs it: `station …` in a terminal of its own, on a bus and a data folder of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

SHARED_VARIABLES = ("STATION_BUS", "STATION_BUS_PASSWORD", "STATION_DATA")
LOCK_STEP = (
    "g1.pace=command", "motion.pace=state", "g1.command_timeout_s=20", "motion.patience_s=20", "recorder.preroll_s=60",
)  # fmt: skip
"""Robot and motion server wait for each other; simulated time stands still meanwhile. The robot writes its first state
once. The long pre-roll keeps that state in the episode, even when the recorder starts late."""
RUNBOOK = "runbooks/g1-sim-motion.yaml"
ROOT = Path(__file__).parents[2]


class Terminal:
    """A user's environment: what is started here meets nothing that runs elsewhere.

    Args:
        folder: Holds the bus's socket (so its path is short), logs and episodes.
        prefix: What each command line begins with, so that it runs elsewhere: `tests.network_link.link.End.prefix`.
    """

    def __init__(self, folder: Path, prefix: tuple[str, ...] = ()) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        kept = {name: value for name, value in os.environ.items() if name not in SHARED_VARIABLES}
        own = {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder / "state", "XDG_CONFIG_HOME": folder / "config",
               "STATION_DATA": folder / "data"}  # fmt: skip
        self.environment = kept | {name: str(place) for name, place in own.items()}
        self.data = folder / "data"
        self.prefix = prefix

    def run(self, *arguments: str, timeout_s: float = 300.0) -> subprocess.CompletedProcess[str]:
        """Run a verb to its end."""
        return subprocess.run(
            [*self.prefix, sys.executable, "-m", "station", *arguments],
            cwd=ROOT, env=self.environment, capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Start a verb that runs until it is told to stop; its output is in one stream."""
        return subprocess.Popen(
            [*self.prefix, sys.executable, "-m", "station", *arguments],
            cwd=ROOT, env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    def json(self, *arguments: str) -> Any:
        """Run a verb and return the JSON that it prints, whatever it thinks of it."""
        done = self.run(*arguments, "--json")
        assert done.stdout, f"station {' '.join(arguments)} ended with {done.returncode}: {done.stderr}"
        return json.loads(done.stdout)

    def episode(self, task: str) -> Path:
        """Return the folder of the only episode of a task."""
        (folder,) = (self.data / task).iterdir()
        return folder


def up(task: str, *settings: str) -> list[str]:
    """Return the arguments that run the main job unattended and record it."""
    sets = [word for setting in settings for word in ("--set", setting)]
    return ["up", RUNBOOK, "--yes", "--record", "--task", task, *sets]


def begins_with_a_state(audit: dict[str, Any]) -> bool:
    """Whether a recording holds the state of its first step; one that begins behind that state is derived from the next
    step on, as a run of its own."""
    return not audit["not_derived"].startswith("step 0 has no robot_state_")
