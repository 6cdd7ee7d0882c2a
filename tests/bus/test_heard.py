"""What is known of writes: up to the newest question that was answered, without a break since a link was well."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from station.bus.hearing import HeardSpan, HearingProof, MissedWrites

GAP_S, PROBE_S = 0.2, 0.05


def test_nothing_is_known_before_it_begins() -> None:
    assert HearingProof(GAP_S).span == HeardSpan(0, 0)


def test_an_answer_proves_what_was_written_before_its_question_and_no_more() -> None:
    hearing = HearingProof(1e-6)
    hearing.begin(1000)
    hearing.prove(1600, 1900)
    assert hearing.span == HeardSpan(1000, 1600)


def test_where_it_stood_still_for_too_long_between_two_answers_the_span_begins_anew() -> None:
    hearing = HearingProof(1e-6)
    hearing.begin(1000)
    hearing.prove(1600, 2000)
    assert hearing.span == HeardSpan(1000, 1600), "1000 ns from the last proof to this answer"
    hearing.prove(2500, 2601)
    assert hearing.span == HeardSpan(2601, 2500), "empty: the server may have come to itself only just now"
    hearing.prove(2650, 2660)
    assert hearing.span == HeardSpan(2601, 2650)


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=30))
def test_no_span_reaches_over_a_server_that_was_frozen_for_longer_than_the_gap(
    pauses: list[tuple[float, float]],
) -> None:
    """One question at a time, a pause after each answer; the server is frozen from any time on until it answers."""
    hearing, now_s, answered_s = HearingProof(GAP_S), 1.0, 1.0
    hearing.begin(round(now_s * 1e9))
    for well_s, frozen_s in pauses:
        asked_s = now_s = answered_s + PROBE_S + well_s
        answered_s = now_s + frozen_s
        hearing.prove(round(asked_s * 1e9), round(answered_s * 1e9))
        assert hearing.span.until_ns == round(asked_s * 1e9)
        if frozen_s > GAP_S:
            assert hearing.span.since_ns == round(answered_s * 1e9)


def test_a_key_that_is_read_unasked_and_differs_was_not_told_of_unless_it_is_read_again_before_the_answer() -> None:
    told = MissedWrites[int]()
    told.record_read({"a": 1, "b": 1})
    told.record_unasked({"a": 1, "b": 1})
    assert not told.untold()
    told.record_unasked({"a": 2, "b": 3})
    told.record_read({"a": 4})
    assert told.untold() == "b"
    told.record_read({"b": 3})
    assert not told.untold()


def write_or_hear(steps: list[str]) -> str:
    """Play a server that tells of every write, as late as it likes but before an answer; return what is untold."""
    told, value, pending, asked = MissedWrites[int](), 0, False, False
    told.record_read({"k": value})
    for step in steps:
        if step == "write":
            value, pending = value + 1, True
        elif step == "hear" and pending:
            pending = False
            told.record_read({"k": value})
        elif step == "look" and not asked:
            asked = True
            told.record_unasked({"k": value})
        elif step == "answer" and asked:
            asked = False
            if pending:
                pending = False
                told.record_read({"k": value})
            if key := told.untold():
                return key
    return ""


@given(st.lists(st.sampled_from(["write", "hear", "look", "answer"]), max_size=60))
def test_a_write_that_is_told_of_a_moment_later_is_never_taken_for_one_that_is_not(steps: list[str]) -> None:
    assert not write_or_hear(steps)
