"""Two writers of one key are noticed when they alternate, and only then."""

from __future__ import annotations

from station.life.writer_conflict import FOREIGN, WriterConflict


def test_one_writer_has_no_rival() -> None:
    rivals = WriterConflict()
    assert not any(rivals.see("a", tick * 0.02) for tick in range(100))


def test_two_that_alternate_are_reported_once() -> None:
    rivals = WriterConflict()
    found = [rivals.see("ab"[tick % 2], tick * 0.01) for tick in range(300)]
    assert [names for names in found if names] == [("a", "b")]


def test_a_foreign_writer_beside_a_native_one_is_a_rival() -> None:
    rivals = WriterConflict()
    found = [rivals.see(name, at) for at, name in enumerate(["a", FOREIGN, "a"])]
    assert found == [(), (), ()]  # a second apart: too far
    rivals = WriterConflict()
    found = [rivals.see(name, at * 0.1) for at, name in enumerate(["a", FOREIGN, "a"])]
    assert found[-1] == ("a", FOREIGN)


def test_a_writer_that_takes_over_for_good_is_no_rival() -> None:
    rivals = WriterConflict()
    writers = ["old"] * 50 + ["new"] * 50
    assert not any(rivals.see(name, tick * 0.02) for tick, name in enumerate(writers))


def test_a_rival_that_comes_again_after_a_quiet_time_is_reported_again() -> None:
    rivals = WriterConflict()
    story = [("a", 0.0), ("b", 0.1), ("a", 0.2)] + [("a", 0.2 + tick * 0.1) for tick in range(1, 30)]
    story += [("b", 3.3), ("a", 3.4)]
    assert sum(bool(rivals.see(name, at)) for name, at in story) == 2


def test_a_third_writer_is_news() -> None:
    rivals = WriterConflict()
    story = [("a", 0.0), ("b", 0.1), ("a", 0.2), ("c", 0.3), ("a", 0.4)]
    assert [found for name, at in story if (found := rivals.see(name, at))] == [("a", "b"), ("a", "b", "c")]
