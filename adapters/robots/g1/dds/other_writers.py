"""Other programs that write a topic which only one may write."""

from __future__ import annotations

from adapters.robots.g1.dds.network import Network

_LOOKS_EVERY = 10  # periods


class OtherWriters:
    """Other programs that write a topic. `poll` comes once in each control period.

    Args:
        network: The robot's.
        topic: The topic.
    """

    def __init__(self, network: Network, topic: str) -> None:
        self._network, self._topic = network, topic
        self._polls, self._other = 0, ""

    def poll(self) -> None:
        """Check for other writers, ten periods apart; to look through all of them takes 3 ms."""
        is_time = self._polls % _LOOKS_EVERY == 0
        self._polls += 1
        if is_time and self._network.have_writers_changed():
            others = self._network.writers_of(self._topic)
            self._other = str(others[0]) if others else ""

    def why_not(self) -> str:
        """Return that another program writes it, and which, or ""."""
        return f"another program writes {self._topic}: {self._other}" if self._other else ""
