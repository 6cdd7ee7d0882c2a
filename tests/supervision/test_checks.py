from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import cast

import pytest

from station import config
from station.bus.client import Bus
from station.errors import ConfigError, NotReady
from station.supervision.checks import DiskCheck
from station.supervision.disk_need import DiskNeed

NO_BUS = cast(Bus, None)


@pytest.fixture
def half_a_gb(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk with so much left."""
    blocks = os.statvfs_result((1000, 1000, 10**6, 500_000, 500_000, 0, 0, 0, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda _path: blocks)


@pytest.mark.usefixtures("half_a_gb")
def test_a_disk_is_told_in_minutes(tmp_path: Path) -> None:
    data = tmp_path / "not" / "there"
    found = DiskCheck(min_free_gb=0.1, mb_per_minute=100).run(NO_BUS, data, threading.Event())
    assert found.endswith(f"GB free at {tmp_path}, 5 min at 100 MB/min")


@pytest.mark.usefixtures("half_a_gb")
def test_what_the_runbook_says_counts_before_what_is_expected(tmp_path: Path) -> None:
    need = DiskNeed(250.0, "3 cameras, estimated")
    check = DiskCheck(min_free_gb=0.1)
    assert check.look(tmp_path, need).endswith("2 min at 250 MB/min (3 cameras, estimated)")
    assert DiskCheck(min_free_gb=0.1, mb_per_minute=100).look(tmp_path, need).endswith("5 min at 100 MB/min")
    with pytest.raises(NotReady, match=r"2 min at 250 MB/min \(3 cameras, estimated\), 5 needed"):
        DiskCheck(min_free_gb=0.1, min_minutes=5).look(tmp_path, need)


@pytest.mark.usefixtures("half_a_gb")
def test_a_disk_that_is_too_small_fails_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(NotReady, match=r"0.5 GB free, 2 needed; make room"):
        DiskCheck().run(NO_BUS, tmp_path, threading.Event())
    with pytest.raises(NotReady, match=r"0.5 GB free are 5 min at 100 MB/min, 6 needed; make room"):
        DiskCheck(min_free_gb=0, min_minutes=6, mb_per_minute=100).run(NO_BUS, tmp_path, threading.Event())


def test_a_rate_that_fills_no_disk_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"mb_per_minute is 0.0, expected more than 0"):
        config.build(DiskCheck, {"mb_per_minute": 0}, where="step 1")
