"""Which reasons against an episode tell of the machine that made it, and not of what is under test."""

from __future__ import annotations

OF_A_BUSY_MACHINE = frozenset({"gap", "slow", "old-command", "interrupted", "commands-ended", "jerky", "misaligned"})
"""Rules that find a station late. Nobody may expect a machine to be idle that runs the tests; what else is found in an
episode (a loss, a fall, a hole, a rival, a joint that does not follow) is never the machine's."""
