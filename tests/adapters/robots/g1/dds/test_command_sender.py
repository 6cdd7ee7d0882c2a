"""What a robot's adapter makes of what a guard answers, in whatever order it comes."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.robots.g1.dds.command_sender import GuardedSender
from adapters.robots.g1.dds.guard_client import ANSWER, SHORT, VERSION, Answer, Kind, Reason, State, sealed
from station.clock import SYSTEM


class Guard:
    """The other end of the line: it says what it is told to say."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(20.0)
        self.port = int(self._socket.getsockname()[1])
        self._nonce = 0
        self._peer: object = None

    def wait_for(self, kind: Kind) -> None:
        """Wait until it is asked for something."""
        while True:
            data, self._peer = self._socket.recvfrom(2048)
            if len(data) == SHORT.itemsize and (asked := np.frombuffer(data, SHORT)[0])["kind"] == kind:
                self._nonce = int(asked["token"]) if kind is Kind.ARM else self._nonce
                return

    def say(self, kind: Answer, state: State, reason: Reason = Reason.NONE) -> None:
        record = np.zeros(1, ANSWER)
        record["magic"], record["version"], record["size"] = b"G1GS", VERSION, record.itemsize
        record["kind"], record["state"], record["reason"] = kind, state, reason
        record["nonce"], record["challenge"] = self._nonce, 4711
        self._socket.sendto(sealed(record), self._peer)  # type: ignore[call-overload]

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def guard() -> Iterator[Guard]:
    made = Guard()
    yield made
    made.close()


def test_a_guard_that_damps_as_soon_as_it_has_armed_is_told_with_its_reason(guard: Guard) -> None:
    sender = GuardedSender("127.0.0.1", guard.port, SYSTEM)
    try:
        sender.open()
        guard.wait_for(Kind.ARM)
        guard.say(Answer.CHALLENGE, State.WAITING)
        sender.poll()
        guard.wait_for(Kind.CONFIRM)
        guard.say(Answer.ARMED, State.ARMED)
        guard.say(Answer.STATUS, State.DAMPING, Reason.NO_STATE)
        sender.poll()
        assert not sender.open()
        assert sender.why_not_drive().startswith("guard: ")
    finally:
        sender.close(np.zeros(1), np.zeros(29))
