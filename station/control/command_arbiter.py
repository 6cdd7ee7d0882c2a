"""Which of several writers of a key is obeyed, so that no robot follows two operators in turn. Pure; its time is given.

The first writer is obeyed. Another is refused until the first has been silent for a while; with ``newest`` a writer
that begins is obeyed at once. If this process was paused, missing commands prove nothing: the silence timer restarts. A
proven silence counts until that writer writes again. Each change is a handover: the gate blends into the new writer's
commands.
"""

from __future__ import annotations

import math
import socket
from dataclasses import dataclass
from typing import Literal

from station.bus import stamp
from station.life.writer_conflict import FOREIGN, WriterConflict

Rule = Literal["keep-first", "newest"]

_APART_S = 1.0  # writes further apart are no contest; also the least time between two reports of one
_MOST = 16  # writers that are remembered; a stranger may invent names
_LONGEST = 80  # characters of a name that are told


@dataclass(frozen=True, slots=True)
class News:
    """Something to be told of the writers of a key.

    Attributes:
        kind: ``rivals`` compete, ``alone`` again, or a ``handover``.
        writers: All rivals; or the writer that was obeyed and the one that is.
        obeyed: The writer that is obeyed now.
        refused: Writes refused since the rivals were first told.
        reason: Why, for a handover.
    """

    kind: Literal["rivals", "alone", "handover"]
    writers: tuple[str, ...]
    obeyed: str
    refused: int = 0
    reason: str = ""


class CommandArbiter:
    """Decides of each write whether it is obeyed.

    Args:
        rule: Which writer to obey.
        silent_after_s: A writer that has been silent for longer gives way to any other [s].
    """

    def __init__(self, rule: Rule = "keep-first", silent_after_s: float = 0.3) -> None:
        self._rule, self._silent_after_s = rule, silent_after_s
        self._rivals = WriterConflict(_APART_S)
        self._heard: dict[str, float] = {}  # newest write, in the order of writes
        self._silent: set[str] = set()  # of them, those proven silent that have not written since
        self._is_unknown = False  # whether the bus stood still since the obeyed writer's last write
        self._news: list[News] = []
        self._competing: tuple[str, ...] = ()
        self._told_s: float | None = None
        self._refused = 0
        self.obeyed = ""

    def on_write(self, writer: str, now_s: float, known_s: tuple[float, float] = (-math.inf, math.inf)) -> bool:
        """Record a write; return whether it is obeyed.

        Args:
            writer: Its writer.
            now_s: When it came [s].
            known_s: Span in which every write was heard [s]: only within it do missing writes prove a silence.
        """
        self.know((known_s[0], min(now_s, known_s[1])))
        begins = writer not in self._heard or writer in self._silent
        self._remember(writer, now_s)
        if writer != self.obeyed:
            if self.obeyed not in self._heard or self.obeyed in self._silent:
                self._hand_over(writer, f"{spoken(self.obeyed)} has been silent" if self.obeyed else "")
            elif self._rule == "newest" and begins:
                self._hand_over(writer, "it began to write last")
        obeyed_s = self._heard[self.obeyed]
        self._is_unknown = known_s[0] > obeyed_s and now_s - obeyed_s > self._silent_after_s
        self._record_rivals(writer, now_s)
        is_obeyed = writer == self.obeyed
        self._refused += not is_obeyed
        return is_obeyed

    def alive(self, writer: str, now_s: float) -> None:
        """Record that a known writer wrote, where the value was not seen; an unknown writer stays unknown."""
        if writer in self._heard:
            self._heard[writer] = now_s
            if writer == self.obeyed:  # for others, the first write that is seen begins
                self._silent.discard(writer)

    def know(self, known_s: tuple[float, float]) -> None:
        """Record which writers were silent in a span in which every write was heard [s]."""
        since_s, until_s = known_s
        for writer, at_s in self._heard.items():
            if until_s - max(at_s, since_s) > self._silent_after_s:
                self._silent.add(writer)

    def pop_news(self, now_s: float) -> tuple[News, ...]:
        """Return what is new of the writers, each piece once."""
        others = [name for name, at_s in self._heard.items() if name != self.obeyed and now_s - at_s <= _APART_S]
        if self._competing and not others:
            self._news.append(News("alone", self._competing, self.obeyed, self._refused))
            self._competing, self._refused, self._told_s = (), 0, None
        news, self._news = tuple(self._news), []
        return news

    @property
    def refusal(self) -> str:
        """Why a write is refused."""
        if not self.obeyed:
            return "two write, and which of them wrote it cannot be told"
        if self._is_unknown:
            return f"the bus stands still too often to know whether {spoken(self.obeyed)} is silent"
        return f"{spoken(self.obeyed)} is obeyed until it has been silent for {self._silent_after_s * 1e3:.0f} ms"

    def _remember(self, writer: str, now_s: float) -> None:
        self._heard.pop(writer, None)
        self._heard[writer] = now_s
        self._silent.discard(writer)
        if len(self._heard) > _MOST:
            oldest = next(name for name in self._heard if name != self.obeyed)
            del self._heard[oldest]
            self._silent.discard(oldest)

    def _hand_over(self, writer: str, reason: str) -> None:
        if self.obeyed:
            self._news.append(News("handover", (self.obeyed, writer), writer, reason=reason))
        self.obeyed = writer

    def _record_rivals(self, writer: str, now_s: float) -> None:
        found = self._rivals.see(writer, now_s)
        if found and (self._told_s is None or now_s - self._told_s >= _APART_S):
            self._competing, self._told_s = found, now_s
            self._news.append(News("rivals", found, self.obeyed, self._refused))


def spoken(source: str) -> str:
    """Return a source in words: name, process and machine, as far as its stamp tells them."""
    if source == FOREIGN:
        return "a foreign writer"
    name, _, rest = source.partition(".")
    pid, boot = (*rest.split("."), "", "")[:2]
    here = boot == stamp.boot_id()
    where = socket.gethostname() if here else f"another machine, boot {boot}"
    return f"{name} (pid {pid} on {where})"[:_LONGEST]
