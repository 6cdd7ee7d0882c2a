"""Notices two writers of one key: a robot that obeys two operators in turn. Pure; its time is given.

A writer is the source in its stamps, or `FOREIGN`: two that write without stamps cannot be told apart.
(`station.control.command_arbiter` decides which of them is obeyed.)
"""

from __future__ import annotations

FOREIGN = "foreign"
"""How a writer without stamps is called."""


class WriterConflict:
    """Told of each writer it sees; speaks once when two alternate.

    One writer that follows another (a server that was restarted) is no rival: only one that writes again after the
    other did, within the window, is.

    Args:
        window_s: How near the writes of two writers must be [s].
    """

    def __init__(self, window_s: float = 1.0) -> None:
        self._window_s = window_s
        self._turns: list[tuple[str, float]] = []  # last write of each turn, newest last
        self._reported: frozenset[str] = frozenset()

    def see(self, writer: str, now_s: float) -> tuple[str, ...]:
        """Record a write; return the rivals, sorted, when they are newly found, else nothing."""
        if self._turns and self._turns[-1][0] == writer:
            self._turns.pop()
        self._turns.append((writer, now_s))
        self._turns = [turn for turn in self._turns if now_s - turn[1] <= self._window_s][-8:]
        names = [name for name, _ in self._turns]
        found = frozenset(names) if len(set(names)) < len(names) else frozenset()
        if len(set(names)) == 1:
            self._reported = frozenset()  # alone again: a later rival is news
        if not found or found <= self._reported:
            return ()
        self._reported = found
        return tuple(sorted(found))
