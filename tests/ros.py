"""A real ROS 2, in an environment of its own (``make ros2``), and nodes of it that tests start."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.tiers import ROOT

PEER = ROOT / "tests/ros_peer.py"
_LEAVES_S = 5.0
_NO_ROS = "no ROS 2 for the tests: make ros2, or STATION_ROS_PYTHON=/path/to/python of one"


def ros_python() -> str:
    """Return the Python of a ROS 2; a machine without one skips, CI fails."""
    path = os.environ.get("STATION_ROS_PYTHON") or str(Path(sys.prefix) / "ros2/bin/python")
    if Path(path).exists():
        return path
    if os.environ.get("CI"):
        pytest.fail(_NO_ROS)
    pytest.skip(_NO_ROS)


def stock(assets: Path) -> dict[str, str]:
    """Return variables with which stock nodes find what they import beside ROS: torch, NumPy, message_filters."""
    torch = importlib.util.find_spec("torch")
    assert torch is not None
    assert torch.origin is not None
    return {"PYTHONPATH": f"{assets / 'peers'}:{Path(torch.origin).parents[1]}"}


class Peer:
    """A node of ROS that does what it is told and says what it hears; on a domain of its own with the bridge.

    Args:
        domain: ROS domain.
    """

    def __init__(self, domain: int) -> None:
        self._process = subprocess.Popen(
            [ros_python(), str(PEER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        )  # fmt: skip
        self.pid = self._process.pid
        self.ask("hello")

    def ask(self, what: str, **given: Any) -> Any:
        """Have it do something; return its answer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"what": what, **given}) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, "the node of the test has ended"
        answer = json.loads(line)
        assert "error" not in answer, answer
        return answer["answer"]

    def publish(self, topic: str, kind: str, rate_hz: float = 50.0, best_effort: bool = False, **fields: Any) -> None:
        """Publish a message again and again from now on, in place of what it published there before."""
        self.ask("publish", topic=topic, kind=kind, rate_hz=rate_hz, best_effort=best_effort, fields=fields)

    def burst(self, topics: dict[str, str], rate_hz: float, count: int) -> dict[str, Any]:
        """Publish on topics of some types, one after the other, so many times; return what that takes by itself."""
        return self.ask("burst", topics=topics, rate_hz=rate_hz, count=count)

    def cease(self, topic: str) -> None:
        """Publish no more on a topic."""
        self.ask("cease", topic=topic)

    def listen(self, topic: str, kind: str) -> None:
        """Keep what comes on a topic from now on."""
        self.ask("listen", topic=topic, kind=kind)

    def heard(self, topic: str) -> list[dict[str, Any]]:
        """Return what came on a topic: fields by name."""
        return self.ask("heard", topic=topic)

    def call(self, service: str, kind: str, **fields: Any) -> dict[str, Any]:
        """Call a service; return its response."""
        return self.ask("call", service=service, kind=kind, fields=fields)

    def leave(self) -> None:
        """Have it end in order, which leaves no shared memory behind; kill it where it does not."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVES_S)
        self.kill()

    def kill(self) -> None:
        """Kill it, as ``kill -9`` does."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with contextlib.suppress(BrokenPipeError):
                stream.close()


@contextlib.contextmanager
def peer(domain: int) -> Iterator[Peer]:
    """Give a node that ends with the block."""
    made = Peer(domain)
    try:
        yield made
    finally:
        made.leave()
