"""An operator is not interrupted: no sample of a device comes so late that driving ends by itself."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

import pytest

from station.control.gate import GateConfig
from tests.figures import Figures
from tests.late_verdicts import expect_no_worse_in_time
from tests.lateness import STALE_S, TooLate, Waits, in_time
from tests.servers.arm_trials import move_and_let_go
from tests.servers.operated_trials import Driven, be_silent_and_crash, record_and_begin_anew, wave_walk_and_leave

ROUNDS = 3
GATE = GateConfig(hold_after_s=0.5, return_after_s=2.0)

pytestmark = [pytest.mark.timeout(600), pytest.mark.usefixtures("processes")]


def expect_told(driven: Driven, waits: Waits, *names: str, losses: int = 0) -> None:
    """This was told of driving and nothing else; or the device fell silent more often than the trial let it, because a
    process had to wait."""
    found = [name for name, _ in driven.told]
    if found != list(names) and len(driven.losses) > losses:
        raise TooLate(f"{driven.losses[-1]}: {found}", STALE_S / 2, waits.longest_s)
    assert found == list(names)


def test_an_operator_waves_walks_and_leaves_without_an_interruption(tmp_path: Path, proof: Figures) -> None:
    def once() -> float:
        with Waits.watched() as waits:
            driven = wave_walk_and_leave(Path(mkdtemp(dir=tmp_path)), GATE)
        expect_told(driven, waits, "engaged", "disengaged", "engaged", "mode", "disengaged", "exit")
        assert driven.followed > 0.8
        return driven.followed

    share = in_time(once, ROUNDS)
    proof.figure("operator with a headset: steps in which it is followed", 100 * share, "%", limit="80 %")


def test_a_device_is_lost_as_often_as_it_is_gone(tmp_path: Path, proof: Figures) -> None:
    def once() -> None:
        with Waits.watched() as waits:
            driven = be_silent_and_crash(Path(mkdtemp(dir=tmp_path)), GATE)
        expect_told(driven, waits, *["engaged", "disengaged"] * 3, "engaged", losses=3)

    in_time(once, ROUNDS)


def test_an_episode_that_was_begun_anew_is_usable(tmp_path: Path, proof: Figures) -> None:
    def once() -> None:
        with Waits.watched() as waits:
            quality = record_and_begin_anew(Path(mkdtemp(dir=tmp_path)), GATE)
        expect_no_worse_in_time("usable", quality, waits)

    in_time(once, ROUNDS)


def test_an_arm_is_let_go_by_its_operator_alone(tmp_path: Path, proof: Figures) -> None:
    def once() -> None:
        with Waits.watched() as waits:
            reasons = move_and_let_go(Path(mkdtemp(dir=tmp_path)))
        if reasons != ["released"]:
            raise TooLate(f"{reasons}", STALE_S / 2, waits.longest_s)

    in_time(once, ROUNDS)
