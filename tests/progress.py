"""What a run of the suite prints: how far it is, and what failed; at its end what was slow and what was skipped."""

from __future__ import annotations

import os
import time
from collections import Counter
from typing import Any

import pytest

from tests import figures, leftovers, tiers

EVERY_S = 5.0
SLOWEST = 10
_LONGEST = 200
FETCHED = "twist2-model twist2-motions twist2-checkpoint"


def distributes(config: pytest.Config) -> bool:
    """Whether this process gives the tests to others, and runs none."""
    return bool(getattr(config.option, "numprocesses", None)) and not hasattr(config, "workerinput")


class Progress:
    """Counts the tests of a run; in a worker of a distributed one it does nothing."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._is_worker = hasattr(config, "workerinput")
        self._is_quiet = self._is_worker or config.get_verbosity() > 0
        self._left: list[str] = []
        self._began_s = self._said_s = time.monotonic()
        self._total = 0
        self._seconds: Counter[str] = Counter()
        self._outcomes: Counter[str] = Counter()
        self._without_data = 0
        self._build_is_green: bool | None = None
        self._files = leftovers.files_in_checkout()

    def pytest_report_teststatus(self, report: Any) -> tuple[str, str, str] | None:
        """Print no letters where lines are printed."""
        if self._is_quiet or report.skipped or (report.passed and report.when != "call"):
            return None
        word = "passed" if report.passed else "failed" if report.when == "call" else "error"
        return word, "", word.upper()

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        self._total = len(session.items)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, node: Any, ids: list[str]) -> None:
        self._total = len(ids)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Count what a test did; say at once that it failed, and now and then how far the run is."""
        self._seconds[report.nodeid] += report.duration  # type: ignore[assignment]
        if report.when == "call" or not report.passed:
            self._outcomes[report.outcome] += 1
            if report.skipped and "STATION_ASSETS" in str(report.longrepr):
                self._without_data += 1
            if "build" in report.keywords and not report.skipped:
                self._build_is_green = report.passed and self._build_is_green is not False
        if report.failed and not self._is_quiet:
            self._print(f"failed: {report.nodeid}: {_why(report)}")
        now_s = time.monotonic()
        if not self._is_quiet and now_s - self._said_s >= EVERY_S:
            self._said_s = now_s
            self._print(self._line(now_s))

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a run that leaves files in the checkout; which test did, only a run of fewer tests tells."""
        ran = not self._is_worker and not session.config.option.collectonly  # beside which others may write
        self._left = sorted(leftovers.files_in_checkout() - self._files) if ran else []
        if self._left and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Say what took longest, and what was not run for want of upstream data."""
        from tests.lateness import EXCUSED

        for report in terminalreporter.getreports("passed"):
            for line in report.caplog.splitlines():
                if EXCUSED in line:
                    terminalreporter.write_line(f"{report.nodeid}: {line}")
        slow = [(seconds, name) for name, seconds in self._seconds.most_common(SLOWEST) if seconds >= 1.0]
        if slow:
            terminalreporter.section(f"slowest {len(slow)}")
            for seconds, name in slow:
                terminalreporter.write_line(f"{seconds:6.1f} s  {name}")
        if self._left:
            terminalreporter.write_line(f"FAILED: the run leaves files in the checkout: {', '.join(self._left)}")
        if self._build_is_green:
            tiers.built(self._config)
        if self._config.getoption("--write-figures"):
            figures.write_page(figures.written(self._config))
        if self._without_data:
            terminalreporter.write_line(
                f"{self._without_data} tests were skipped for want of upstream data: `station assets fetch {FETCHED}` "
                "gets it; STATION_ASSETS names its folder (docs/assets.md)"
            )

    def _line(self, now_s: float) -> str:
        done, minutes = sum(self._outcomes.values()), (now_s - self._began_s) / 60
        share = f"{100 * done // self._total:3d} %" if self._total else ""
        bad = self._outcomes["failed"]
        return f"{share} {done} of {self._total} tests, {bad} failed, {minutes:.1f} min"

    def _print(self, line: str) -> None:
        reporter = self._config.pluginmanager.getplugin("terminalreporter")
        if reporter is not None and not os.environ.get("PYTEST_XDIST_WORKER"):
            reporter.ensure_newline()
            reporter.write_line(line)


def _why(report: pytest.TestReport) -> str:
    """Return why a test failed, in a line; all of it is told at the end of the run."""
    crash = getattr(report.longrepr, "reprcrash", None)
    text = crash.message if crash is not None else str(report.longrepr)
    return text.partition("\n")[0][:_LONGEST]
