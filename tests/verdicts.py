"""Verdicts on episodes that were recorded on a machine which may have been busy."""

from __future__ import annotations

from station.episode.quality.findings import Quality, Reason, Verdict

OF_LATENESS = frozenset({
    "arm-sync", "bus-lost", "bus-silent", "commands-ended", "device-gap", "device-slow", "gap", "interrupted",
    "old-command", "server-paused", "slow",
})  # fmt: skip
"""Rules that a process may break which waits for a processor; `tests.late_verdicts` asks of some whether one did."""

OF_A_LATE_MACHINE = frozenset({"bus-lost", "bus-silent", "server-paused"})
"""Those of them that can be broken in lock-step, where times say nothing of the control."""


def worse_than(than: Verdict, quality: Quality) -> list[Reason]:
    """Return the reasons for a worse verdict."""
    worse = ("reject",) if than == "usable" else ("reject", "usable")
    return [reason for reason in quality.reasons if reason.verdict in worse]


def expect_no_worse_but_late(than: Verdict, quality: Quality) -> None:
    """Fail where anything but lateness gives an episode a worse verdict."""
    of_lateness = OF_A_LATE_MACHINE if quality.lock_step else OF_LATENESS
    assert {reason.rule for reason in worse_than(than, quality)} <= of_lateness, quality.reasons
