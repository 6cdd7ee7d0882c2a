"""A claimed folder is one claimant's, empty at the beginning and gone at the end."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from station.foreign.take_in import claimed

CLAIMANTS, ROUNDS = 6, 25


def test_claimants_have_it_one_after_the_other_and_find_nothing_there(tmp_path: Path) -> None:
    making, inside = tmp_path / "data" / ".importing-x", []

    def claim(number: int) -> None:
        for _ in range(ROUNDS):
            with claimed(making):
                inside.append(number)
                assert inside == [number]
                make(making)
                assert inside.pop() == number

    with ThreadPoolExecutor(CLAIMANTS) as threads:
        for done in [threads.submit(claim, number) for number in range(CLAIMANTS)]:
            done.result()
    assert list((tmp_path / "data").iterdir()) == []


def make(making: Path) -> None:
    making.mkdir()
    (making / "file").write_text("half")


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    making = tmp_path / ".importing-x"
    make(making)
    (tmp_path / ".importing-x.lock").touch()
    with claimed(making):
        assert not making.exists()
    assert list(tmp_path.iterdir()) == []


def test_what_fails_within_leaves_nothing(tmp_path: Path) -> None:
    making = tmp_path / ".importing-x"

    def fail() -> None:
        with claimed(making):
            make(making)
            raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        fail()
    assert list(tmp_path.iterdir()) == []
