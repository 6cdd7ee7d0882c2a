"""Whom of several writers a robot obeys."""

from __future__ import annotations

import math
import os
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.bus import stamp
from station.control.command_arbiter import CommandArbiter, News, Rule, spoken
from station.life.writer_conflict import FOREIGN

DT = 0.02


def hear(writers: CommandArbiter, story: list[tuple[str, float]]) -> tuple[list[bool], list[News]]:
    obeyed: list[bool] = []
    told: list[News] = []
    for writer, at_s in story:
        obeyed.append(writers.on_write(writer, at_s))
        told += writers.pop_news(at_s)
    return obeyed, told


def test_the_only_writer_is_obeyed_whoever_it_is_and_nothing_is_told() -> None:
    for name in ("a", FOREIGN):
        obeyed, told = hear(CommandArbiter(), [(name, tick * DT) for tick in range(100)])
        assert all(obeyed)
        assert not told


def test_the_second_is_refused_and_told_by_the_first_write_after_its_own() -> None:
    obeyed, told = hear(CommandArbiter(), [("ab"[tick % 2], tick * DT) for tick in range(100)])
    assert obeyed == [True, False] * 50
    assert told == [News("rivals", ("a", "b"), "a", 1)]


def test_slow_writers_are_told_within_200_ms() -> None:
    story = [("a", tick * 0.1) for tick in range(20)] + [("b", 1.05 + tick * 0.1) for tick in range(10)]
    writers = CommandArbiter()
    for writer, at_s in sorted(story, key=lambda item: item[1]):
        writers.on_write(writer, at_s)
        if writers.pop_news(at_s):
            assert at_s - 1.05 <= 0.2
            return
    raise AssertionError("never told")


def test_once_the_first_has_been_silent_the_second_is_obeyed_and_that_is_a_handover() -> None:
    first = [("a", tick * DT) for tick in range(50)]
    second = [("b", 0.99 + tick * DT) for tick in range(50)]
    obeyed, told = hear(CommandArbiter(), [*first, *second])
    assert obeyed[50:] == [False] * 15 + [True] * 35, "300 ms and no earlier"
    assert [news.kind for news in told] == ["handover"], "one after the other are no rivals"
    assert told[0].writers == ("a", "b")


@pytest.mark.parametrize("rule", ["keep-first", "newest"])
def test_who_stood_still_himself_has_heard_no_silence(rule: Rule) -> None:
    writers = CommandArbiter(rule)
    known_s = (-math.inf, 1.0)
    for tick in range(51):
        for name in "ba":
            writers.on_write(name, tick * DT, known_s)
    first, _ = writers.obeyed, writers.pop_news(1.0)
    assert not writers.on_write("ab"[first == "a"], 3.0, known_s), "two seconds of which nothing is known"
    known_s = (3.01, 3.2)
    assert not writers.on_write("ab"[first == "a"], 3.25, known_s), "now it is known of a fifth of a second"
    assert writers.on_write(first, 3.26, known_s)
    assert all(news.kind != "handover" for news in writers.pop_news(3.26))
    known_s = (3.01, 3.6)
    assert writers.on_write("ab"[first == "a"], 3.61, known_s), "0.34 s of which it is known"


def test_the_end_of_the_contest_is_told_with_the_number_of_refused_writes() -> None:
    both = [("ab"[tick % 2], tick * 0.01) for tick in range(100)]
    _, told = hear(CommandArbiter(), [*both, *(("a", 1.0 + tick * DT) for tick in range(100))])
    assert [news.kind for news in told] == ["rivals", "alone"]
    assert told[1].refused == 50


def test_the_newest_is_obeyed_from_its_first_write_where_that_is_the_rule() -> None:
    writers = CommandArbiter("newest")
    hear(writers, [("a", tick * DT) for tick in range(50)])
    obeyed, told = hear(writers, [("ba"[tick % 2], 1.0 + tick * 0.01) for tick in range(100)])
    assert obeyed == [True, False] * 50
    assert [news.kind for news in told] == ["handover", "rivals"]
    assert told[1].obeyed == "b"


def test_who_begins_right_after_the_bus_stood_still_is_obeyed_where_that_is_the_rule() -> None:
    writers = CommandArbiter("newest")
    for name, at_s in (("b", 0.0), ("a", 0.5)):
        writers.on_write(name, at_s, (-1.0, at_s))
    for tick in range(50):
        writers.on_write("a", 0.5 + tick * DT, (-1.0, 0.5 + tick * DT))
    assert writers.obeyed == "a"
    assert writers.on_write("b", 2.1, (2.0, 2.05)), "it let go before that, and was heard to"
    assert not writers.on_write("a", 2.12, (2.0, 2.05))
    assert writers.on_write("b", 2.14, (2.0, 2.05)), "and a, who has not let go, takes nothing back"


def test_a_silence_that_was_heard_is_not_forgotten_when_the_bus_stands_still_afterwards() -> None:
    for knows in (True, False):
        writers = CommandArbiter()
        writers.on_write("a", 0.0, (-1.0, 0.0))
        if knows:
            writers.know((-1.0, 0.4))
        assert writers.on_write("b", 2.1, (2.0, 2.05)) == knows
    writers = CommandArbiter()
    writers.on_write("a", 0.0, (-1.0, 0.0))
    writers.know((-1.0, 0.4))
    assert writers.on_write("a", 2.0, (1.9, 2.0))
    assert not writers.on_write("b", 2.1, (1.9, 2.1)), "he writes again"


def test_who_lives_is_not_silent_though_nothing_else_is_known_of_his_writes() -> None:
    writers = CommandArbiter()
    writers.on_write("a", 0.0)
    for tick in range(50):
        writers.alive("a", tick * DT)
        assert not writers.on_write("b", tick * DT)
    writers = CommandArbiter("newest")
    writers.on_write("a", 0.0)
    writers.alive("b", 0.5)
    assert writers.on_write("b", 0.51), "of a stranger it is nothing, nor of one who let go: his first write begins"
    for tick in range(50):
        writers.on_write("b", 0.52 + tick * DT)
    writers.alive("a", 1.6)
    assert writers.on_write("a", 1.61)


def test_a_refusal_says_where_a_bus_that_stands_still_keeps_silence_from_being_known() -> None:
    writers = CommandArbiter()
    for name in "ab":
        writers.on_write(name, 0.0, (-1.0, 0.0))
    assert writers.refusal == f"{spoken('a')} is obeyed until it has been silent for 300 ms"
    assert not writers.on_write("b", 0.6, (0.5, 0.6))
    assert writers.refusal == f"the bus stands still too often to know whether {spoken('a')} is silent"
    writers.on_write("a", 0.7, (0.5, 0.7))
    writers.on_write("b", 0.71, (0.5, 0.7))
    assert writers.refusal == f"{spoken('a')} is obeyed until it has been silent for 300 ms"


def test_invented_names_fill_no_memory_and_are_told_once_a_second() -> None:
    writers = CommandArbiter()
    story = [(name, tick * 0.001) for tick in range(5000) for name in ("a", f"x{tick}")]
    obeyed, told = hear(writers, story)
    assert obeyed == [True, False] * 5000
    assert len(told) <= 6
    assert len(writers._heard) <= 16


@given(st.lists(st.tuples(st.sampled_from(["a", "b", "c", FOREIGN]), st.floats(0.0, 0.3)), max_size=60))
def test_at_most_one_is_obeyed_and_hands_change_only_after_silence(steps: list[tuple[str, float]]) -> None:
    writers, now_s, last_s = CommandArbiter(), 0.0, dict[str, float]()
    for writer, wait_s in steps:
        now_s += wait_s
        before = writers.obeyed
        is_obeyed = writers.on_write(writer, now_s)
        assert is_obeyed == (writer == writers.obeyed)
        if before and writers.obeyed != before:
            assert now_s - last_s[before] > 0.3
        last_s[writer] = now_s


def test_a_source_is_named_with_process_and_machine() -> None:
    host = socket.gethostname()
    assert spoken(stamp.new_source("motion")) == f"motion (pid {os.getpid()} on {host})"
    assert spoken("quest.7.0a1b2c3d.ff") == "quest (pid 7 on another machine, boot 0a1b2c3d)"
    assert spoken(FOREIGN) == "a foreign writer"
    assert spoken("x").startswith("x (pid ")
    assert len(spoken("x" * 500)) == 80
