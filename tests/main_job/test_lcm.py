"""Two stations that meet on LCM alone: one has the devices, the other the robot; and a policy of others."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import station
from station.episode.storage.manifest import load_manifest
from tests.adapters.lcm.loopback import multicast_loopback
from tests.adapters.lcm.test_multicast import free_port
from tests.main_job.station_runs import ROOT, Terminal
from tests.waiting import DEADLINE_S, wait_until

FAKES = (
    "gamepad.fake=builtin:gamepad/example.json",
    "left_leader.fake=builtin:gello/g1.json",
    "right_leader.fake=builtin:gello/g1-right.json",
)

pytestmark = pytest.mark.timeout(300)


@contextmanager
def in_the_background(terminal: Terminal, *words: str) -> Iterator[subprocess.Popen[str]]:
    process = terminal.start(*words)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=2 * DEADLINE_S)


def test_a_gamepad_of_one_station_walks_the_robot_of_another_over_lcm(tmp_path: Path, processes: None) -> None:
    port, robots, devices = free_port(), Terminal(tmp_path / "r"), Terminal(tmp_path / "d")
    fakes = [word for setting in (*FAKES, f"homie.port={port}") for word in ("--set", setting)]
    with in_the_background(devices, "up", "homie-robot", "--yes", *fakes):
        words = ("--yes", "--record", "--task", "carry", "--for", "14s", "--set", f"cockpit.port={port}")
        done = robots.run("up", "g1-homie-cockpit", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    episode = str(robots.episode("carry"))
    check, audit = robots.json("check", episode), robots.json("audit", episode)
    assert check["falls"] == 0
    walked = {stream["key"]: stream["count"] for stream in check["streams"]}["action_velocity_g1_29_legs"]
    assert walked > 200
    legs = audit["parts"]["legs"]
    assert (legs["compared"] > 200, legs["different"], audit["different"]) == (True, 0, 0)
    live = [event.source for event in load_manifest(Path(episode)).events if event.name == "lcm-live"]
    assert set(live) == {"cockpit"}
    assert len(live) <= 2, (
        "once for the pedals, and where a leader's script came near enough to its arm, once for those"
    )


# -- A policy of others moves our robot ------------------------------------------------------------------------------
PEDALS = """
import sys, time
from adapters.lcm import types
from adapters.lcm.multicast import Multicast
to, message = Multicast(), types.COMMAND.encode({"command": [0.4, 0.0, 0.0, 0.74]})
while True:
    to.send("pedal_command", message)
    time.sleep(0.02)
"""
HOMIE = "STATION_HOMIE"
_NO_HOMIE = (
    f"{HOMIE} does not say how HOMIE's own policy is started: the command line of its deploy_policy.py here, which is "
    "not part of the station"
)
WALKS_S, FROZEN_S = 6.0, 4.0


class Run:
    """The station in a network of its own, whose robot a policy moves over LCM.

    Args:
        folder: For the bus and the episode.
        inside: What a command line begins with, so that it runs there.
        settings: Of the runbook's servers.
    """

    def __init__(self, folder: Path, inside: tuple[str, ...], settings: Sequence[str]) -> None:
        self._terminal, self._inside, self._log = Terminal(folder / "t", inside), inside, folder / "policy.log"
        sets = [word for setting in settings for word in ("--set", setting)]
        self._up = self._terminal.start("up", "g1-homie-policy", "--yes", "--record", "--task", "walk", *sets)

    def events(self, name: str) -> list[Any]:
        """Return the events of a name that are recorded by now; of the whole run once it has ended."""
        return [event for event in load_manifest(self._terminal.episode("walk")).events if event.name == name]

    @contextmanager
    def policy(self, words: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
        """Run a policy until the end of the block."""
        with self._log.open("ab") as log, subprocess.Popen(
            [*self._inside, *words], cwd=ROOT, stdout=log, stderr=log, start_new_session=True,
        ) as process:  # fmt: skip
            try:
                yield process
            finally:
                os.killpg(process.pid, signal.SIGKILL)

    def await_said(self, what: str, count: int = 1) -> None:
        """Wait until policies have said a word so often."""
        wait_until(lambda: self._log.read_text().split().count(what) >= count, 4 * DEADLINE_S)

    def end(self) -> station.Episode:
        """End the station; return what it recorded."""
        self._up.terminate()
        said, _ = self._up.communicate(timeout=2 * DEADLINE_S)
        assert self._up.returncode in (0, -15, 143), said
        return station.open_episode(self._terminal.episode("walk"))

    def kill(self) -> None:
        """Let nothing of it stay."""
        if self._up.poll() is None:
            self._up.terminate()
            self._up.communicate(timeout=2 * DEADLINE_S)


@contextmanager
def run(folder: Path, *settings: str) -> Iterator[Run]:
    with multicast_loopback() as inside:
        made = Run(folder, inside, settings)
        try:
            yield made
        finally:
            made.kill()


def walked_m(episode: station.Episode) -> float:
    """Return how far from its start the robot ended."""
    rows = episode.numpy("sim_qpos_g1_29").values
    return float(np.linalg.norm(rows[-1, :2] - rows[0, :2]))


def test_homies_own_policy_walks_our_robot(tmp_path: Path, processes: None) -> None:
    if not (words := shlex.split(os.environ.get(HOMIE, ""))):
        pytest.skip(_NO_HOMIE)
    with run(tmp_path) as made, made.policy([sys.executable, "-c", PEDALS]), made.policy(words):
        wait_until(lambda: made.events("lcm-live"), 8 * DEADLINE_S)
        time.sleep(2 * WALKS_S)
        episode = made.end()
    assert "fall" not in [record.value["name"] for record in episode.events()]
    assert walked_m(episode) > 2.0
