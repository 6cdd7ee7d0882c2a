"""Who else writes a topic that is ours alone to write."""

from __future__ import annotations

from cyclonedds.idl import IdlStruct

from adapters.robots.g1.dds.network import Network

_LOOKS_EVERY = 10  # periods
_LOOKS_WELL_EVERY = 250  # periods; to look through all that was discovered takes 3 ms, and finds writers of odd types


class OtherWriters:
    """Other programs that write a topic. `poll` comes once in each control period.

    Args:
        network: The robot's.
        topic: The topic.
        kind: Its type.
    """

    def __init__(self, network: Network, topic: str, kind: type[IdlStruct]) -> None:
        self._network, self._topic = network, topic
        self._reader = network.reader(topic, kind, depth=1)  # is matched with every writer at once
        self._known, self._polls, self._other = -1, 0, ""

    def poll(self) -> None:
        """Check for other writers, ten periods apart."""
        is_time = self._polls % _LOOKS_EVERY == 0
        self._polls += 1
        if is_time and (self._reader.writers() != self._known or self._polls % _LOOKS_WELL_EVERY == 1):
            self._known = self._reader.writers()
            others = self._network.writers_of(self._topic)
            self._other = str(others[0]) if others else ""

    def why_not(self) -> str:
        """Return that another program writes it, and which, or ""."""
        return f"another program writes {self._topic}: {self._other}" if self._other else ""
