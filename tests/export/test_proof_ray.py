"""A Ray cluster does what processes do. It takes a minute to come up, so this is asked with the proofs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from station.export.jobs import Attempt, map_episodes
from tests.cli.running import are_gone
from tests.export.test_jobs import ROOT, check_squares, die, needs_ray, square
from tests.waiting import wait_until

# Ray is not imported to see whether it is there: it changes the environment, and no child would start warm any more.
pytestmark = [pytest.mark.usefixtures("processes"), needs_ray]


def test_the_same_work_on_a_ray_cluster_of_two_workers_gives_the_same_and_leaves_nothing_behind(proof: object) -> None:
    """In a process of its own: Ray is no guest that leaves a process as it was."""
    with tempfile.TemporaryDirectory(prefix="r-") as folder:  # with a path that is short enough for Ray's sockets
        found = driven(Path(folder))
        assert list(Path(folder).rglob("*")) == [], "neither a token nor a session"
    check_squares({item: error or result for item, result, error in found["squares"]})
    assert [result for _, result, _ in found["deaths"]] == [None, 2]
    assert "the Ray worker that had it died" in found["deaths"][0][2]
    assert found["listening"] == [], "what runs whatever it is sent listens to nobody else"
    assert len(found["pids"]) >= 4
    wait_until(lambda: are_gone(found["pids"]))


def driven(folder: Path) -> dict[str, Any]:
    """Run `on_ray` in another process, whose home and temporary folder are this one."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "from tests.export.test_proof_ray import on_ray; on_ray()"],
        cwd=ROOT, capture_output=True, text=True, timeout=100, check=False, start_new_session=True,
        env={**os.environ, "HOME": str(folder), "TMPDIR": str(folder)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def on_ray() -> None:
    """Run as a driver; say what came out, whom Ray had started, and which of them the network could reach."""

    def told(attempts: list[Attempt[int, int]]) -> list[tuple[int, int | None, str]]:
        return [(each.item, each.result, each.error) for each in attempts]

    pids: set[int] = set()
    listening: set[str] = set()

    def look(_: Attempt[int, int]) -> None:
        ours = descendants(os.getpid())
        pids.update(ours)
        listening.update(address for address in listeners(ours) if address not in LOOPBACK)

    squares = told(map_episodes(square, range(1, 9), jobs=2, ray_address="local", on_done=look))
    deaths = told(map_episodes(die, [1, 2], jobs=2, ray_address="local", on_done=look))
    facts = {"squares": squares, "deaths": deaths, "pids": sorted(pids), "listening": sorted(listening)}
    print(json.dumps(facts))  # noqa: T201


LOOPBACK = ("0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F")


def descendants(pid: int) -> list[int]:
    """Children of a process, their children …"""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except (FileNotFoundError, ProcessLookupError):
                continue
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found[1:]


def listeners(pids: list[int]) -> set[str]:
    """Addresses that some processes listen at, as the kernel writes them."""
    sockets: set[str] = set()
    for pid in pids:
        try:
            links = [os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir()]
        except (FileNotFoundError, ProcessLookupError):
            continue
        sockets |= {link[len("socket:[") : -1] for link in links if link.startswith("socket:[")}
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {row[1].split(":")[0] for row in rows if row[3] == "0A" and row[9] in sockets}
