"""Whether a machine that was late can be the reason for the verdict of an episode; for proofs."""

from __future__ import annotations

from collections.abc import Callable

from station.episode.quality.findings import Quality, Verdict
from tests.lateness import STALE_S, TooLate, Waits
from tests.verdicts import worse_than

_PERIOD_S = 0.02
_HEARTBEAT_S = 0.5
_LASTING = (0.3 + 1.0) / 0.3  # of an interruption to its cause: a silence of 0.3 s, and a second of entering after it
_SLOW_SHARE = 0.05  # of the writes are missing in a stream that is slow


def _gap(quality: Quality, waits: Waits) -> tuple[float, float]:
    timed = [stream.longest_gap_s or 0.0 for stream in quality.streams if stream.nominal_hz is not None]
    return max(timed) / 2, waits.longest_s  # two may wait in turn


def _interrupted(quality: Quality, waits: Waits) -> tuple[float, float]:
    interrupted_s = max(robot.interrupted_share for robot in quality.steps) * quality.duration_s
    return max(STALE_S / 2, interrupted_s / _LASTING), waits.seconds() if waits.longest_s >= STALE_S / 2 else 0.0


def _old_command(quality: Quality, waits: Waits) -> tuple[float, float]:
    return max(robot.command_age.p99_s or 0.0 for robot in quality.steps) - 2 * _PERIOD_S, waits.longest_s


def _slow(quality: Quality, waits: Waits) -> tuple[float, float]:
    return _SLOW_SHARE * quality.duration_s, waits.seconds()


def _device_slow(quality: Quality, waits: Waits) -> tuple[float, float]:
    return max(stream.slowest_s or 0.0 for stream in quality.streams if stream.role == "sensor") - 1.0, waits.seconds()


def _server_paused(quality: Quality, waits: Waits) -> tuple[float, float]:
    return max(one.seconds for one in quality.silences) - _HEARTBEAT_S, waits.longest_s


_LATENESS: dict[str, Callable[[Quality, Waits], tuple[float, float]]] = {
    "device-gap": _gap,
    "device-slow": _device_slow,
    "gap": _gap,
    "interrupted": _interrupted,
    "old-command": _old_command,
    "server-paused": _server_paused,
    "slow": _slow,
}
"""By how much a process was late at least for what a rule finds, and how long one was kept waiting, at a stretch or in
all [s]. Those but gap and interrupted never reject an episode."""


def expect_no_worse_in_time(than: Verdict, quality: Quality, waits: Waits) -> None:
    """Fail where an episode has a worse verdict.

    Raises:
        TooLate: It has, and for nothing but what comes of being late.
    """
    waits.seconds()
    against = worse_than(than, quality)
    assert {reason.rule for reason in against} <= set(_LATENESS), quality.reasons
    if against:
        proofs = [_LATENESS[reason.rule](quality, waits) for reason in against]
        late_s, waited_s = min(proofs, key=lambda proof: proof[1] - proof[0])  # the one that is proven least
        raise TooLate("; ".join(reason.text for reason in against), late_s, waited_s)
